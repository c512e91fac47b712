from ._agreement import Agreement as Agreement, agreement as agreement
from ._baselines import regress_friction as regress_friction
from ._hand import (
    HandErrors as HandErrors,
    hand_effects as hand_effects,
    hand_errors as hand_errors,
)
from ._mask_quality import MaskQuality as MaskQuality, mask_quality as mask_quality
from ._sensitivity import output_sensitivity as output_sensitivity
from ._sign_check import SignCheck as SignCheck, sign_check as sign_check
