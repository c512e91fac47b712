from textwrap import fill

from ...network import CSLC
from .._held_out import HeldOut
from ..solver import Identification
from ..systematic import SystematicError
from ._excitation import Excitation


def joint_lines(network: CSLC) -> list[str]:
    """The numbers that coefficients' names have, with the joints' names where they have such."""
    robot = network.robot
    if not robot.has_joint_names:
        return []
    mimics = () if robot.source is None else robot.source.mimics
    leaders = {mimic.follower: f" (follows {mimic.leader})" for mimic in mimics}
    joints = ", ".join(
        f"{i} {name}{leaders.get(name, '')}" for i, name in enumerate(robot.joint_names, start=1)
    )
    return [fill(f"joints: {joints}", 96, subsequent_indent="    ", break_on_hyphens=False)]


def expression_legend(network: CSLC) -> str:
    """What symbols in the expressions of a robot's coefficients mean, and in which frames.

    >>> import jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> expression_legend(jc.derive(pendulum, lengths="numeric"))[:58]
    'kB: base parameters. Of link i: mi mass, rxi ryi rzi centr'
    """
    groups = {
        "mass": "kM: of the mass matrix",
        "gravity": "kG: of gravity",
        "base": "kB: base parameters",
    }
    present = dict.fromkeys(c.group for c in network.coefficients)
    names = "; ".join(text for group, text in groups.items() if group in present)
    forms = {inertia.form for inertia in network.robot.inertia}
    about = "the origin" if forms == {"full"} else "the centre of gravity"
    if len(forms) > 1:
        about = "the origin (principal moments: the centre of gravity)"
    return (
        f"{names}. Of link i: mi mass, rxi ryi rzi centre of gravity, Ixxi to Iyzi moments of"
        f" inertia about {about}, Imi motor inertia, in the link's modified Denavit-Hartenberg"
        " frame: z along the axis of joint i, x along the common normal to the next axis"
    )


def expression_text(network: CSLC) -> str:
    """`expression_legend` in lines to print."""
    return fill(expression_legend(network), 96, subsequent_indent="    ")


def determination_lines(
    fit: Identification,
    fitted: int,
    excitation: Excitation | None,
    systematic: SystematicError | None = None,
) -> list[str]:
    """What the intervals of a fit allow for, and what its patterns determine.

    - `fitted`: how many coefficients were fitted.
    """
    causes = "" if systematic is None else "; and for systematic errors by "
    causes += "" if systematic is None else ", ".join(systematic.parts)
    lines = [
        f"low and high: 95 % intervals for {fit.errors} errors,"
        f" {float(fit.degrees_of_freedom):.0f} degrees of freedom{causes}",
        *(f"not determined: {sentence}" for sentence in fit.unidentifiable),
    ]
    text = f"rank {int(fit.rank)} of {fitted}, condition {float(fit.condition):.4g}"
    if excitation is not None:
        text += f"; least determined: {excitation.worst_combination}"
    return [*lines, text]


def held_out_lines(held_out: HeldOut | None, outputs: str = "joint by joint") -> list[str]:
    """Held-out errors over training errors.

    - `outputs`: how the ratios are listed.
    """
    if held_out is None:
        return []
    ratios = ", ".join(f"{ratio:.3g}" for ratio in held_out.ratio)
    return [f"{held_out.source} RMS over training RMS, {outputs}: {ratios}"]
