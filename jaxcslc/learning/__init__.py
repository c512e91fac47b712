from ._factors import JointFactors as JointFactors, factorise as factorise
from ._identification import Identification as Identification
from ._least_squares import fit_factors as fit_factors, least_squares as least_squares
from ._solution import RESULTS as RESULTS
from ._streaming import least_squares_stream as least_squares_stream
