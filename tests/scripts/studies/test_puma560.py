"""The thesis's experiment on a shorter recording: everything is written, and is what it says.

One run serves all tests. What tables claim is computed again from the recordings and coefficients
that the run wrote, with nothing of the experiment's own.
"""

import contextlib
import csv
import functools
import io
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

import jaxcslc as jc
import sim
from jaxcslc.cli._example import next_commands
from jaxcslc.uncertainty import TOLERANCES
from scripts.studies.puma560 import experiment
from scripts.studies.puma560.figures import CAPTIONS
from scripts.studies.puma560.machines import machines
from scripts.studies.puma560.own_arm import COMMANDS, FOLDER
from scripts.studies.puma560.page import EXPERIMENT
from scripts.studies.puma560.reversals import clean_turn, clearest_ramps
from scripts.studies.puma560.thresholds import passage


MODELS = {"Ar+LS": "Ar+LS", "CSLC": "value", "true": "true"}
"""Columns of the error table, and of the table of coefficients."""
# How the experiment prepares the comparison recording to judge it, as the thesis does and in
# another way, and a quick run its fit.
THESIS = jc.Preparation(
    jc.AveragedSplines(17), torque_alignment="previous", thresholds=0.0, trim=100
)
JUDGED = jc.Preparation(jc.AveragedSplines(17), torque_alignment="mean", thresholds=0.01)
QUICK = jc.Settings(
    jc.Preparation(jc.AveragedSplines(13), torque_alignment="mean"), jc.LeastSquares(cutoff=8.0)
)
LEAST_SHARE = 0.8  # of 95 % intervals that contain the truth in spite of every disturbance
SAMPLES = 1500  # of a quick run's longest recording
# Tables have all digits; predictions come from another order of the same sums.
assert_same = functools.partial(assert_allclose, rtol=1e-9, atol=1e-12)


@dataclass(frozen=True)
class Demo:
    """What a run left behind."""

    folder: Path
    figures: dict[str, Figure]
    printed: str

    def rows(self, table: str) -> list[dict[str, str]]:
        with (self.folder / f"{table}.csv").open(encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def column(self, table: str, name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in self.rows(table)])

    def recording(self, letter: str, trajectory: str) -> jc.Recording:
        return jc.load_recording(self.folder / f"puma_{letter}_{trajectory}.csv")


Torque = Callable[[np.ndarray, jc.Patterns], np.ndarray]


@pytest.fixture(scope="module")
def torque(puma: jc.CSLC) -> Torque:
    """The network's torque of any patterns, compiled once: shorter ones are filled up."""
    compiled = jax.jit(puma.torque)

    def of(k: np.ndarray, patterns: jc.Patterns) -> np.ndarray:
        columns = (patterns.q, patterns.qd, patterns.qdd)
        filled = [np.resize(np.asarray(x), (SAMPLES, 6)) for x in columns]
        return np.asarray(compiled(k, *filled))[: patterns.samples]

    return of


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    folder = tmp_path_factory.mktemp("demo") / "experiment"
    (folder / FOLDER / "results").mkdir(parents=True)  # an earlier run left it
    figures: dict[str, Figure] = {}

    def keep(figure: Figure, path: Path) -> None:
        figures[path.stem.removeprefix("figure_")] = figure
        figure.savefig(path, dpi=20)

    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(experiment, "save_picture", keep)
        assert experiment.main(["--quick", "-o", str(folder)]) == 0
    yield Demo(folder, figures, printed.getvalue())


def test_page_has_every_table_and_figure(demo: Demo) -> None:
    page = (demo.folder / EXPERIMENT).read_text(encoding="utf-8")
    written = {path.name for path in demo.folder.iterdir()}
    # A quick run trains nothing.
    assert set(demo.figures) == set(CAPTIONS) - {"7.5"}
    assert {name for name in re.findall(r'src="([^"]+)"', page)} == {
        f"figure_{number}.png" for number in demo.figures
    }
    linked = set(re.findall(r'href="([^"#]+)"', page))
    recordings = {
        name for name in written if re.fullmatch(r"puma_[ab]_(train|compar)\w+.csv", name)
    }
    assert len(recordings) == 4
    assert linked == {name for name in written if name.endswith(".csv")} - recordings


def test_front_page_shows_the_tool_then_the_thesis(demo: Demo) -> None:
    page = (demo.folder / "index.html").read_text(encoding="utf-8")
    assert page.count("data-chart=") == 3  # the arm, and the torques of two joints
    page = re.sub("<(script|style).*?</\\1>", "", page, flags=re.DOTALL)
    headings = re.findall(r"<h2[^>]*>([^<]+)</h2>", page)
    assert headings == [
        "Identify an arm from its files",
        "What comes back",
        "The experiment of the thesis",
    ]
    assert not re.search("PERAL|epoch", page[: page.index('id="terms"')])
    files = set(re.findall(r'(?:src|href)="([^"#]+)"', page))
    assert files == {
        "panda/identify.svg",
        "panda/results/index.html",
        "figure_7.6-1.png",
        EXPERIMENT,
    }
    assert all((demo.folder / file).is_file() for file in files)
    shown = {row[""]: row for row in demo.rows("errors_b")}["mean ε"]
    assert all(f"{float(shown[model]):.3g}</td>" in page for model in ("Ar+LS", "CSLC", "true"))


def test_front_page_shows_commands_that_exist() -> None:
    """Those that `jaxcslc example` says what to type next."""
    typed = {line.partition("#")[0].strip() for line in COMMANDS.splitlines()[1:]}
    assert typed <= set(next_commands(Path("panda"), "panda.urdf"))


def test_front_page_counts_the_intervals_of_its_report(demo: Demo) -> None:
    report = jc.load_report(demo.folder / FOLDER / "results")
    with (demo.folder / FOLDER / "truth.json").open(encoding="utf-8") as file:
        coefficients = json.load(file)["coefficients"]
    table = report.to_pandas()
    truth = np.array([coefficients[name] for name in report.names])
    inside = int(((table["low"] <= truth) & (truth <= table["high"])).sum())
    assert f"{inside} of {len(truth)} intervals contain the true value" in demo.printed
    assert inside / len(truth) > LEAST_SHARE


def test_terminal_shows_few_lines(demo: Demo) -> None:
    lines = demo.printed.splitlines()
    assert len(lines) <= 14  # of 15, one is the command that `make` shows
    assert max(map(len, lines[1:-1])) <= 100  # the first and the last have a path
    assert lines[-1].startswith("Open ") and EXPERIMENT in lines[-1]


def test_figures_say_which_machine_they_show(demo: Demo) -> None:
    for number, figure in demo.figures.items():
        title = figure.get_suptitle() or figure.axes[0].get_title()
        assert title.startswith("PUMA B" if number == "7.6-2" else "PUMA A"), number


def test_torque_figures_show_the_recordings(demo: Demo) -> None:
    for number, letter in (("7.6-1", "a"), ("7.6-2", "b")):
        recording = demo.recording(letter, "comparison")
        patterns = JUDGED.patterns(recording)
        for axes in demo.figures[number].axes:
            match = re.match(r"joint (\d)", axes.get_ylabel())
            if match is None:
                assert axes.get_ylabel() == "error [N m]"
                continue
            measured = next(line for line in axes.lines if line.get_label() == "measured")
            shown = np.asarray(measured.get_ydata(), float)
            assert_allclose(shown, patterns.torque[:, int(match[1]) - 1])


@pytest.mark.parametrize(("number", "joint"), [("7.2-2", 2), ("7.2-2b", 3)])
def test_linearity_figure_is_of_puma_a(demo: Demo, puma: jc.CSLC, number: str, joint: int) -> None:
    """The line's intercept is the weight of PUMA A's arm, its slope gravity times the lever."""
    machine = sim.puma_a()
    pose = np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0])
    assert machine.robot.links is not None
    weight = puma.gravity_term(puma.coefficients_from(machine.robot.links), pose)
    point, _ = sim.Hand.of(machine.robot, (0.0, 0.0, 0.05625)).locate(pose)
    (axes,) = demo.figures[number].axes
    line = next(x for x in axes.lines if str(x.get_label()).startswith("line"))
    mass, mean = (np.asarray(values, float) for values in line.get_data())
    slope = np.diff(mean) / np.diff(mass)
    assert_allclose(mean[0], abs(float(weight[joint - 1])), atol=0.5)
    # About the joint's axis, joint 3's is at the end of a2 (the arm points straight out along x);
    # the weights pull the arm a little below the horizontal.
    axis = {2: 0.0, 3: jc.puma560().length_values()["a2"]}[joint]
    assert_allclose(slope, 9.81 * (abs(float(np.asarray(point)[0])) - axis), rtol=0.02)
    # Armstrong's arm differs: joint 2 would need 10 N m less.
    robot = jc.puma560()
    assert robot.links is not None
    other = puma.gravity_term(puma.coefficients_from(robot.links), pose)
    assert abs(mean[0] - abs(float(other[joint - 1]))) > {2: 5.0, 3: 1.0}[joint]
    # The motor is linear in the whole range: the heaviest measurement is on the line too.
    points = next(x for x in axes.lines if x.get_label() == "measurement")
    heaviest = np.asarray(points.get_data(), float)[:, -1]
    # The oscillation is averaged over one period, not long after it began: 0.4 % of the torque.
    assert_allclose(heaviest[1], mean[0] + slope[0] * heaviest[0], atol=1.0)


@pytest.mark.parametrize("letter", ["a", "b"])
def test_error_table_is_what_recordings_and_coefficients_give(
    demo: Demo, torque: Torque, letter: str
) -> None:
    recording = demo.recording(letter, "comparison")
    rows = {row[""]: row for row in demo.rows(f"errors_{letter}")}
    patterns = THESIS.patterns(recording)
    parts = (
        (patterns, "mean ε"),
        (JUDGED.patterns(recording), "mean ε, mean of two demands"),
        (QUICK.patterns(recording), "mean ε, as jaxcslc identify judges"),
    )
    for model, column in MODELS.items():
        k = demo.column(f"coefficients_{letter}", column)
        for part, epsilon in parts:
            error = np.asarray(part.torque) - torque(k, part)
            mask = np.asarray(part.mask)
            square = np.sum(error**2 * mask, axis=1) / np.maximum(mask.sum(axis=1), 1)
            some = mask.any(axis=1)
            assert_same(float(rows[epsilon][model]), np.mean(0.5 * np.sqrt(square[some])))
            if part is patterns:
                shown = [float(rows[f"mean |e{joint}|"][model]) for joint in range(1, 7)]
                mean = [np.abs(error[mask[:, j], j]).mean() for j in range(6)]
                assert_same(shown, mean)
    assert float(rows["mean ε, thesis"]["Ar+Rg"]) == {"a": 0.698, "b": 0.979}[letter]
    epsilon = {model: float(rows["mean ε"][model]) for model in MODELS}
    assert max(epsilon["CSLC"], epsilon["true"]) < epsilon["Ar+LS"]


def test_command_judges_as_the_table_says(demo: Demo, puma: jc.CSLC) -> None:
    recordings = [demo.recording("a", name) for name in ("training", "comparison")]
    report = jc.identify(puma, *recordings, settings=QUICK, possible="never", file_prior=False)
    (row,) = (row for row in demo.rows("errors_a") if row[""].endswith("identify judges"))
    assert_allclose(float(report.errors["validation"].epsilon[0]), float(row["CSLC"]), rtol=1e-6)
    assert_allclose(report.k, demo.column("coefficients_a", "value"), rtol=1e-6, atol=1e-9)
    assert report.systematic is not None
    # The study's machines have no fault that `identify` allows for.
    systematic = report.systematic.without_causes(TOLERANCES)
    shown = demo.column("coefficients_a", "systematic_error")
    assert_allclose(systematic.total, shown, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("letter", ["a", "b"])
def test_regressed_friction_is_the_best_with_armstrongs_links(
    demo: Demo, puma: jc.CSLC, torque: Torque, letter: str
) -> None:
    """Eqn. 7.6-1: NumPy's own regression gives the column's errors."""
    patterns = QUICK.patterns(demo.recording(letter, "training"))
    compared = THESIS.patterns(demo.recording(letter, "comparison"))
    k = demo.column(f"coefficients_{letter}", "Ar+LS")
    rigid = np.where(np.isin(np.arange(puma.size), puma.layout.friction), 0.0, k)
    error = np.asarray(patterns.torque) - torque(rigid, patterns)
    left = np.asarray(compared.torque) - torque(rigid, compared)
    rows = {row[""]: row for row in demo.rows(f"errors_{letter}")}
    for j in range(6):
        mask, qd = np.asarray(patterns.mask[:, j]), np.asarray(patterns.qd[:, j])
        inputs = np.stack([qd, np.sign(qd)], axis=1)[mask]
        (kv, kd), *_ = np.linalg.lstsq(inputs, error[mask, j], rcond=None)
        speed, judged = np.asarray(compared.qd[:, j]), np.asarray(compared.mask[:, j])
        remaining = left[:, j] - kv * speed - kd * np.sign(speed)
        shown = float(rows[f"mean |e{j + 1}|"]["Ar+Rg"])
        assert_allclose(np.abs(remaining[judged]).mean(), shown, rtol=1e-6)


@pytest.mark.parametrize("letter", ["a", "b"])
def test_coefficients_and_their_intervals(demo: Demo, puma: jc.CSLC, letter: str) -> None:
    table = f"coefficients_{letter}"
    assert [row["name"] for row in demo.rows(table)] == list(puma.names)
    value, low, high, true = (demo.column(table, name) for name in ("value", "low", "high", "true"))
    assert np.all((low < value) & (value < high))
    machine = sim.disturbed({"a": sim.puma_a, "b": sim.puma_b}[letter]())
    expected = puma.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
    assert_allclose(true, expected)
    assert_allclose(
        demo.column(table, "thesis"), sim.thesis_coefficients(letter.upper()).coefficients
    )
    # One quantile of Student's t for all; systematic errors are in, and they make a difference.
    standard, systematic = (
        demo.column(table, "standard_error"),
        demo.column(table, "systematic_error"),
    )
    quantile = 0.5 * (high - low) / np.hypot(standard, systematic)
    assert_allclose(quantile, quantile[0], rtol=1e-9)
    assert 1.9 < quantile[0] < 2.6
    within = np.abs(value - true) <= quantile[0] * np.hypot(standard, systematic)
    (row,) = (row for row in demo.rows("intervals") if row[""] == f"PUMA {letter.upper()}")
    assert int(row["intervals"]) == puma.size
    assert int(row["all causes"]) == within.sum()
    assert int(row["standard error"]) == (np.abs(value - true) <= quantile[0] * standard).sum()
    # A short recording, and disturbances that are none of the causes; hardly any interval would
    # contain the truth by chance: they are narrower than coefficients are far apart.
    assert within.mean() > LEAST_SHARE
    assert np.median(0.5 * (high - low) / np.abs(true)) < 1.0


def test_demands_stay_within_linearity(demo: Demo) -> None:
    limit = demo.column("demands", "limit of linearity [N m]")
    measured = demo.column("demands", "seen to be linear up to [N m]")
    for letter in "ab":
        for name in ("training", "comparison"):
            shown = demo.column("demands", f"PUMA {letter.upper()}, {name} [N m]")
            torque = np.asarray(demo.recording(letter, name).torque)
            assert_allclose(shown, np.abs(torque).max(axis=0))
            # The premise of 7.2.3: no demand beyond the range in which the motor was measured.
            assert np.all(shown < measured)
    assert np.all(measured < limit)
    # Joint 3's range is measured (7.2.3, the double-check), that of the others is joint 2's share.
    points = next(
        line for line in demo.figures["7.2-2b"].axes[0].lines if line.get_label() == "measurement"
    )
    assert_allclose(measured[2], np.max(np.asarray(points.get_ydata(), float)))
    others = np.array([0, 1, 3, 4, 5])
    assert_allclose((measured / limit)[others], (measured / limit)[1])
    assert_allclose(limit / limit[1], np.array(sim.puma_a().maximum_torque) / 186.4)


def test_weak_motors_leave_linearity(demo: Demo, puma: jc.CSLC) -> None:
    rows = demo.rows("weak_motors")
    machine = machines()["PUMA A"]
    trajectory = sim.training(samples=SAMPLES, robot=machine.robot)
    recording = sim.simulate(machine, trajectory, seed=1).recording
    k = QUICK.fit(puma, QUICK.patterns(recording)).k
    errors = jc.compare(puma, JUDGED.patterns(demo.recording("a", "comparison")), {"fit": k})
    shown = [float(row["within the limits"]) for row in rows]
    assert_allclose(shown, [float(row["fit"]) for row in errors.rows()], rtol=1e-6)
    beyond = np.array([float(row["training pairs beyond it [%]"]) for row in rows[:6]])
    assert np.all(beyond[[0, 2, 3, 4, 5]] > 20.0)
    assert {float(row["limit [N m]"]) for row in rows[:6]} == {20.0, 40.0, 16.0, 6.4, 8.0, 11.0}


@pytest.mark.parametrize("letter", ["a", "b"])
def test_thresholds_are_those_of_the_plant_and_of_the_residuals(demo: Demo, letter: str) -> None:
    rows = demo.rows(f"thresholds_{letter}")
    thesis = demo.column(f"thresholds_{letter}", "thesis, and five γ of the plant [rad/s]")
    machine = {"a": sim.puma_a, "b": sim.puma_b}[letter]()
    assert_allclose(thesis, sim.thesis_coefficients(letter.upper()).insignificant_from)
    assert_allclose(thesis, 5 * np.array(machine.static_velocity))
    patterns = QUICK.patterns(demo.recording(letter, "training"))
    least = 0.01 * np.abs(np.asarray(patterns.qd)).max(axis=0)
    thresholds = demo.column(f"thresholds_{letter}", "from residuals [rad/s]")
    seen = np.array([row["seen in residuals"] == "yes" for row in rows])
    assert_allclose(thresholds[~seen], least[~seen])
    assert np.all(thresholds[seen] > least[seen])
    # By the thesis's law alone, every joint that moves slowly at all shows its static friction.
    ideal = [row["seen without asymmetry and compliance"] == "yes" for row in rows]
    assert sum(ideal) >= 5
    fits = {row["thresholds"]: row for row in demo.rows(f"threshold_fits_{letter}")}
    errors = {row[""]: row for row in demo.rows(f"errors_{letter}")}
    shown = float(errors["mean ε, mean of two demands"]["CSLC"])
    assert_same(float(fits["as chosen"]["comparison ε [N m]"]), shown)
    share = {name: float(row["pairs that count [%]"]) for name, row in fits.items()}
    assert_allclose(share["as chosen"], 100 * np.mean(np.asarray(patterns.mask)))
    assert share["a hundredth of top speed"] > share["as chosen"] > share["Fig. B.6"]


def test_a_clean_turn_does_not_stick() -> None:
    time = np.linspace(0.0, 1.0, 1000)
    velocity = np.where(time < 0.5, np.sin(6 * np.pi * time), 3 * np.sin(6 * np.pi * time))
    turn = clean_turn(velocity)
    assert time[turn] > 0.5 and velocity[turn] * velocity[turn + 1] <= 0


def test_the_clearest_ramps_are_those_put_in() -> None:
    """One of six reversals of two joints has ramps on both sides, another a higher one on one."""
    time = np.arange(1200)
    qd = np.stack([np.sin(np.pi * (time + 0.5) / 200), np.cos(np.pi * (time + 0.5) / 300)], axis=1)
    error = np.zeros_like(qd)
    ramp = np.exp(-np.abs(qd) / 0.1) * np.sign(qd)
    error[350:450, 0] = 2.0 * ramp[350:450, 0]
    error[600:650, 0] = 9.0 * ramp[600:650, 0]
    error[700:800, 1] = 1.5 * ramp[700:800, 1]
    thresholds, dry = np.array([0.4, 0.4]), np.array([1.0, 1.0])
    ramps = clearest_ramps(qd, error, thresholds, dry)
    assert (ramps.joint, ramps.sample) == (0, 399)
    assert_allclose([ramps.before, ramps.after], ramps.lower, rtol=0.1)
    # In units of a dry friction four times as large, the other joint's are clearer.
    assert clearest_ramps(qd, error, thresholds, np.array([4.0, 1.0])).joint == 1
    with pytest.raises(ValueError, match="expected a joint that turns round"):
        clearest_ramps(np.abs(qd) + 1.0, error, thresholds, dry)


def test_passages_of_a_triangle() -> None:
    velocity = np.concatenate([np.arange(-9.5, 10.0), np.arange(9.5, -10.0, -1.0)])
    assert passage(velocity, 4.0) == 4.0
    assert passage(velocity + 100.0, 4.0) == 0.0
