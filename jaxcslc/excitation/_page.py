import jax.numpy as jnp
import numpy as np

from ..identification.prediction import link_poses
from ..page import (
    Code,
    Column,
    Curve,
    Film,
    Message,
    Page,
    Panel,
    PanelChart,
    Section,
    Table,
    render,
)
from ._criteria import EXPLANATIONS
from ._result import Design


_PAGE_RATE = 50.0  # of curves [Hz]
_FILM_RATE, _FRAMES = 15.0, 400  # frames a second, and at most
_TIP = 0.12  # of the last joint's axis that is drawn [m]
_QUANTITIES = (("Position", "rad"), ("Velocity", "rad/s"), ("Acceleration", "rad/s²"))


def design_page(design: Design, command: str = "") -> str:
    """A page of a design: what it will bring, the motion against its limits, margins."""
    headline, left = _headline(design), design.undetermined
    sections = [_predicted(design), *_film(design), *_motion(design), _margins(design)]
    if command:
        sections.append(Section("Command", "", (Code(command),)))
    page = Page(
        f"Motion for {design.network.name}",
        design.family.description,
        headline,
        "good",
        (
            *([Message(f"Not determined: {', '.join(left)}.", "caution")] if left else []),
            *(Message(note, "plain") for note in design.notes),
        ),
        tuple(sections),
    )
    return render(page)


def _headline(design: Design) -> str:
    names = [name for name in design.wanted if name not in design.undetermined]
    spent = f"{design.family.duration:g} s of this motion determine"
    if not names:
        return f"{spent} none of the coefficients."
    indices = [design.network.names.index(name) for name in names]
    relative = 100 * design.prediction.relative_error[indices]
    worst = int(np.argmax(relative))
    return (
        f"{spent} {len(names)} coefficients to {np.median(relative):.2g} % of their size (median),"
        f" {names[worst]} to {relative[worst]:.2g} %."
    )


def _predicted(design: Design) -> Section:
    rows = tuple(
        (
            row["name"],
            row["unit"],
            row["prior"],
            196 * row["error_before"] / size,
            196 * row["relative"] if known else float("inf"),
        )
        for row, size, known in zip(
            design.prediction.rows(),
            design.prediction.size,
            design.prediction.determined.tolist(),
            strict=True,
        )
    )
    columns = (
        Column("coefficient", numeric=False),
        Column("unit", numeric=False),
        Column("prior value"),
        Column("interval before [%]", "half of a 95 % interval over the size", 3),
        Column("interval after [%]", "half of a 95 % interval over the size", 3),
    )
    lead = (
        f"Designed for: {design.criterion}, {EXPLANATIONS[design.criterion]}; reached"
        f" {design.value:.4g}. The condition number of the regressor is"
        f" {design.prediction.condition:.4g}, with columns of unit length"
        f" {design.prediction.scaled_condition:.4g}."
    )
    return Section("Predicted intervals", lead, (Table(columns, rows, name="predicted"),))


def _film(design: Design) -> list[Section]:
    robot, duration = design.network.robot, design.family.duration
    if any(
        length.value is None for joint in robot.joints for length in (joint.a, joint.b, joint.d)
    ):
        return []  # lengths that are symbols have no positions
    _, (q, _, _) = design.sampled(min(_FILM_RATE, _FRAMES / duration))
    q = np.asarray(design.network.positions_of_all_joints(q))
    n = robot.joint_count
    frames = np.zeros((len(q), n + 1, 2, 3))
    for frame, pose in zip(frames, q, strict=True):
        links = [np.asarray(link) for link in link_poses(robot, pose)]
        frame[:n, 1] = [link[:3, 3] for link in links]
        frame[:n, 0] = [np.zeros(3) if i < 0 else frame[i, 1] for i in robot.parents]
        frame[n] = links[-1][:3, 3] + [np.zeros(3), _TIP * links[-1][:3, 2]]
    caption = f"Lines from joint to joint; {duration:g} s, over and over"
    lead = "The arm in motion; at the end, with a dot, the axis of the last joint."
    return [Section("Film", lead, (Film(frames, duration, caption),))]


def _motion(design: Design) -> list[Section]:
    time, motion = design.sampled(_PAGE_RATE)
    limits, sections = design.limits, []
    names = design.network.output_names
    for order, ((title, unit), values) in enumerate(zip(_QUANTITIES, motion, strict=True)):
        middle, half = limits.symmetric(order)
        lead = f"The motion and its limits, joint by joint [{unit}; m of prismatic joints]."
        sections.append(
            Section(title, lead, (_chart(names, time, values, middle - half, middle + half),))
        )
    if np.any(design.prediction.k):
        k, states = jnp.asarray(design.prediction.k), [jnp.asarray(x) for x in motion]
        torque = np.asarray(design.network.torque(k, *states))
        high = limits.usable_torque
        lead = "Of the prior model, and the limits less their margin [N m or N]."
        sections.append(Section("Torque", lead, (_chart(names, time, torque, -high, high),)))
    return sections


def _chart(
    names: tuple[str, ...], time: np.ndarray, values: np.ndarray, low: np.ndarray, high: np.ndarray
) -> PanelChart:
    panels: list[Panel] = []
    ends = (float(time[0]), float(time[-1]))
    for joint, name in enumerate(names):
        curves = [Curve("motion", time.tolist(), values[:, joint].tolist(), "predicted")]
        for limit in (low[joint], high[joint]):
            if np.isfinite(limit):
                curves.append(Curve("limit", ends, (float(limit),) * 2, "residual"))
        panels.append(Panel(name, tuple(curves), height=90))
    return PanelChart(tuple(panels), "time [s]", "")


def _margins(design: Design) -> Section:
    rows = tuple(
        (
            row["limit"],
            design.network.output_names[row["joint"] - 1] if row["joint"] else "",
            100 * row["margin"] if row["joint"] else 1e3 * row["margin"],
            "%" if row["joint"] else "mm",
        )
        for row in design.use.margins()
    )
    columns = (
        Column("limit", numeric=False),
        Column("joint", numeric=False),
        Column("left", digits=3),
        Column("unit", numeric=False),
    )
    lead = (
        "What is left of each limit at the joint that uses most of it, at all times: what happens"
        " between samples is bounded and counted."
    )
    return Section("Margins", lead, (Table(columns, rows, name="margins-table"),))
