from ._batching import batched_by as batched_by
from ._change import kernel_of as kernel_of, summed_change as summed_change
from ._cost_kernel import CostKernel as CostKernel, cost_kernel as cost_kernel
from ._statements import RuleStatements as RuleStatements, rule_statements as rule_statements
