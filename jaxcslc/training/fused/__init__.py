from ._change import kernel_of as kernel_of, summed_change as summed_change
from ._statements import RuleStatements as RuleStatements, rule_statements as rule_statements
