"""Draw the README's moving picture: an arm, its torques, and intervals that shrink as it moves.

    python -m scripts.tools.readme_picture [-o docs/images/identify.svg]

Everything in it is computed: `jaxcslc example panda` gives the log, each of the intervals is a fit
to the samples so far, and the prediction is of motion that no fit has seen. It is an SVG that moves
by itself (SMIL), so that it needs neither a player nor a script.
"""

import argparse
import tempfile
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.manipulator import link_poses


_SECONDS = 12.0  # a turn of the picture
_FRAMES = 96
_JOINT = 3  # whose torque is drawn: joint 4
_FITS = np.array([0.7, 1.0, 1.5, 2.0, 3.0, 4.5, 6.5, 9.0, 12.0])  # s of motion that are fitted
_SHOWN = 7  # coefficients
_MEASURED, _PREDICTED, _INK, _PALE = "#9aa5b1", "#d9480f", "#1f2933", "#e4e7eb"
_ARM, _SHADOW = "#4263eb", "#cbd2d9"

Points = Float[np.ndarray, "points 2"]


def path(points: Points) -> str:
    """The `d` of a polyline."""
    return "M" + " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def animated(attribute: str, values: list[str], times: np.ndarray | None = None) -> str:
    """A SMIL element that gives `attribute` the values, one after the other, for ever."""
    keys = "" if times is None else ' keyTimes="' + ";".join(f"{t:.3f}" for t in times) + '"'
    return (
        f'<animate attributeName="{attribute}" dur="{_SECONDS:g}s" repeatCount="indefinite"'
        f'{keys} values="{";".join(values)}"/>'
    )


def skeleton(robot: jc.Manipulator, q: Float[np.ndarray, "frames joints"]) -> np.ndarray:
    """Origins of the link frames from the base to a point on the last axis, (frames, points, 3)."""
    poses = np.asarray(link_poses(robot, q))
    tip = poses[:, -1, :3, 3] + 0.2 * poses[:, -1, :3, 2]
    base = np.zeros_like(tip)
    return np.concatenate([base[:, None], poses[:, :, :3, 3], tip[:, None]], axis=1)


def projected(points: np.ndarray) -> np.ndarray:
    """Points of space on the panel of the arm, seen from the side and above, (..., 2)."""
    azimuth, elevation, scale = np.radians(-55), np.radians(18), 205.0
    x = -np.sin(azimuth) * points[..., 0] + np.cos(azimuth) * points[..., 1]
    toward = np.cos(azimuth) * points[..., 0] + np.sin(azimuth) * points[..., 1]
    y = np.cos(elevation) * points[..., 2] - np.sin(elevation) * toward
    return np.stack([140 + scale * x, 282 - scale * y], axis=-1)


def arm(robot: jc.Manipulator, q: Float[np.ndarray, "frames joints"]) -> str:
    """The arm that moves, over its shadow."""
    points = skeleton(robot, q)
    shadow = projected(points * [1, 1, 0])
    body = projected(points)
    parts = ['<ellipse cx="140" cy="284" rx="34" ry="9" fill="#e4e7eb"/>']
    for lines, style in (
        (shadow, f'stroke="{_SHADOW}" stroke-width="9" opacity="0.5"'),
        (body, f'stroke="{_ARM}" stroke-width="13"'),
    ):
        moves = animated("d", [path(frame) for frame in lines])
        parts.append(
            f'<path d="{path(lines[0])}" fill="none" stroke-linecap="round"'
            f' stroke-linejoin="round" {style}>{moves}</path>'
        )
    for joint in range(2, body.shape[1]):
        parts.append(
            f'<circle r="3.2" fill="#fff">'
            f"{animated('cx', [f'{x:.1f}' for x in body[:, joint, 0]])}"
            f"{animated('cy', [f'{y:.1f}' for y in body[:, joint, 1]])}</circle>"
        )
    return "\n".join(parts)


def torques(
    time: np.ndarray, measured: np.ndarray, predicted: np.ndarray, name: str, error: float
) -> str:
    """Measured and predicted torque, with a cursor that runs along."""
    left, right, top, bottom = 330.0, 830.0, 46.0, 140.0
    low, high = measured.min(), measured.max()
    across = left + (right - left) * (time - time[0]) / (time[-1] - time[0])

    def line(values: np.ndarray) -> str:
        down = bottom - (bottom - top) * (values - low) / (high - low)
        return path(np.stack([across, down], axis=-1))

    return "\n".join(
        [
            label(left, 24, f"Torque of {name}, held-out motion [N m]", bold=True),
            label(right, 24, f"error {error:.2f} N m RMS", anchor="end"),
            f'<path d="{line(measured)}" fill="none" stroke="{_MEASURED}" stroke-width="3"/>',
            f'<path d="{line(predicted)}" fill="none" stroke="{_PREDICTED}" stroke-width="1.3"/>',
            f'<line y1="{top - 8}" y2="{bottom + 6}" stroke="{_INK}" stroke-width="1.2">'
            f"{animated('x1', [f'{left}', f'{right}'])}{animated('x2', [f'{left}', f'{right}'])}"
            "</line>",
            label(left, 162, "measured", colour="#7b8794"),
            label(left + 72, 162, "predicted", colour=_PREDICTED),
        ]
    )


def intervals(names: list[str], low: np.ndarray, high: np.ndarray, truth: np.ndarray) -> str:
    """Intervals of coefficients over the truth, fit after fit; `low`, `high`: (fits, names)."""
    left, right, top, row = 400.0, 830.0, 212.0, 15.0
    times = np.concatenate([[0.0], _FITS[:-1] / _FITS[-1] * 0.96, [1.0]])

    def across(relative: np.ndarray) -> np.ndarray:
        return left + (right - left) * (np.clip(relative, 0.4, 1.6) - 0.4) / 1.2

    middle = left + (right - left) / 2
    parts = [
        label(330, 190, "95 % intervals, as seconds of motion are added", bold=True),
        f'<line x1="{middle}" x2="{middle}" y1="{top - 10}" y2="{top + row * len(names) - 6}"'
        f' stroke="{_INK}" stroke-dasharray="3 3"/>',
        label(middle + 4, top + row * len(names) + 6, "true value", colour="#7b8794"),
    ]
    for i, name in enumerate(names):
        y = top + row * i
        start, end = across(low[:, i] / truth[i]), across(high[:, i] / truth[i])
        first = [f"{start[0]:.1f}", *(f"{x:.1f}" for x in start)]
        width = [f"{end[0] - start[0]:.1f}", *(f"{x:.1f}" for x in np.maximum(end - start, 2.0))]
        parts += [
            label(330, y + 4, name),
            f'<line x1="{left}" x2="{right}" y1="{y}" y2="{y}" stroke="{_PALE}"/>',
            f'<rect y="{y - 3.5}" height="7" rx="3" fill="{_ARM}" opacity="0.85">'
            f"{animated('x', first, times)}{animated('width', width, times)}</rect>",
        ]
    return "\n".join(parts)


def label(
    x: float, y: float, text: str, *, bold: bool = False, anchor: str = "start", colour: str = _INK
) -> str:
    weight = ' font-weight="600"' if bold else ""
    return (
        f'<text x="{x}" y="{y}" font-size="13" fill="{colour}" text-anchor="{anchor}"{weight}>'
        f"{text}</text>"
    )


def picture(
    report: jc.Report,
    train: jc.Recording,
    held_out: jc.Recording,
    truth: Float[np.ndarray, " coefficients"],
) -> str:
    """The picture of an identification of which the truth is known, as SVG.

    **Arguments**

    - `train`, `held_out`: that were fitted, and that judged.
    - `truth`: the true coefficients.
    """
    network, settings = report.network, report.settings
    patterns = settings.patterns(train)
    fits = []
    for end in _FITS:
        part = patterns.time < patterns.time[0] + 2.0 + end
        chosen = eqx.tree_at(
            lambda p: (p.backlash_mask,), patterns, (patterns.backlash_mask & part[:, None],)
        )
        fits.append(settings.fit(network, chosen))
    k = np.array([fit.k for fit in fits])
    half = 1.96 * np.array([fit.standard_error for fit in fits])
    size = np.abs(truth)
    drawn = np.flatnonzero((half[-1] < 0.2 * size) & (half[0] > 0.12 * size))[:_SHOWN]

    judged = settings.patterns(held_out)
    measured = np.asarray(judged.torque)
    shown = (judged.time > judged.time[0] + 3) & (judged.time < judged.time[0] + 3 + _SECONDS)
    predicted = np.asarray(network.torque(report.k, judged.q, judged.qd, judged.qdd))
    thinned = np.flatnonzero(shown)[:: max(1, int(shown.sum() / 420))]
    frames = np.flatnonzero(shown)[np.linspace(0, shown.sum() - 1, _FRAMES).astype(int)]
    error = np.sqrt(np.mean((predicted - measured)[shown, _JOINT] ** 2))
    content = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 860 330" width="860" height="330"'
        ' font-family="system-ui, sans-serif" role="img"'
        ' aria-label="A Panda arm moves; measured and predicted torque agree; intervals shrink">',
        '<rect width="860" height="330" rx="10" fill="#ffffff"/>',
        label(24, 24, "Franka Panda, simulated log", bold=True),
        arm(network.robot, np.asarray(judged.q)[frames]),
        torques(
            np.asarray(judged.time)[thinned],
            measured[thinned, _JOINT],
            predicted[thinned, _JOINT],
            f"joint {_JOINT + 1}",
            float(error),
        ),
        intervals(
            [network.names[i] for i in drawn],
            np.where(truth > 0, k - half, k + half)[:, drawn],
            np.where(truth > 0, k + half, k - half)[:, drawn],
            truth[drawn],
        ),
        "</svg>",
    ]
    return "\n".join(content) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/images/identify.svg"))
    arguments = parser.parse_args()
    jc.enable_x64()
    with tempfile.TemporaryDirectory() as folder:
        example = jc.examples.write_example("panda", folder)
        network = jc.derive(jc.load_robot(example.robot))
        train, held_out = (
            jc.load_recording(path, joints=7) for path in (example.train, example.validation)
        )
        report = jc.identify(network, train, validation=held_out, friction="offset")
        drawing = picture(report, train, held_out, jc.examples.read_truth(example, report.network))
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(drawing, encoding="utf-8")
    print(f"wrote {arguments.output}: {arguments.output.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
