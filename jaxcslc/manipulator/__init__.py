from ._errors import RobotError as RobotError
from ._friction import (
    FRICTION_TERMS as FRICTION_TERMS,
    STATIC_SLOPE as STATIC_SLOPE,
    Coupling as Coupling,
)
from ._inertia import LinkInertia as LinkInertia
from ._joint import Joint as Joint, Length as Length
from ._link_parameters import (
    LinkParameters as LinkParameters,
    fixed_together as fixed_together,
    motor_inertia as motor_inertia,
    seen_from as seen_from,
)
from ._manipulator import Manipulator as Manipulator
from ._numbering import Numbering as Numbering, Subnumbering as Subnumbering
from ._placement import Axis as Axis, modified_dh as modified_dh
from ._source import (
    JointLimits as JointLimits,
    Mimic as Mimic,
    Mimics as Mimics,
    Source as Source,
)
from .files import (
    Element as Element,
    load_robot as load_robot,
    panda as panda,
    parse_xml as parse_xml,
    puma560 as puma560,
    read_xml as read_xml,
    tx40 as tx40,
)
