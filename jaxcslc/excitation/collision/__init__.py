from ._bodies import Bodies as Bodies
