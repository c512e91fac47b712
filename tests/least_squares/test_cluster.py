"""Fits of many files on the workers of a cluster: those of one process."""

import csv
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
import numpy as np
import psutil
import pytest
from distributed import Client, LocalCluster
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.least_squares import Work, block_factors
from jaxcslc.recordings import joined_patterns
from tests import arms
from tests.conftest import run


FILES = 5
# Of a factorisation of some 10^3 rows.
_ROUNDING = 1e-11


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    return arms.planar_arm()


@pytest.fixture(scope="module")
def recordings(arm: jc.CSLC) -> list[jc.Recording]:
    """Of robots of slightly different coefficients, with velocities and accelerations."""
    rng = np.random.default_rng(0)
    made: list[jc.Recording] = []
    for number in range(FILES):
        time = 0.01 * np.arange(400 + 10 * number)
        angle = rng.uniform(2.0, 6.0, 2) * time[:, None] + rng.uniform(0.0, 6.0, 2)
        q, qd, qdd = np.sin(angle), np.gradient(np.sin(angle), 0.01, axis=0), -9.0 * np.sin(angle)
        k = np.linspace(0.5, 2.0, arm.size) + 0.1 * number
        torque = np.asarray(arm.regressor(q, qd, qdd)) @ k + 0.1 * rng.normal(size=q.shape)
        made.append(jc.Recording(time, q, torque, qd, qdd))
    return made


@pytest.fixture(scope="module")
def paths(recordings: list[jc.Recording], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("logs")
    files = [folder / f"day{number}.parquet" for number in range(FILES)]
    for path, recording in zip(files, recordings, strict=True):
        jc.save_recording(recording, path)
    return files


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    """Two workers, threads of this process, that others could connect to."""
    options: dict[str, Any] = {"processes": False, "protocol": "tcp://", "dashboard_address": ":0"}
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, **options) as cluster,
        Client(cluster) as connected,
    ):
        yield connected


def as_recorded(recording: jc.Recording) -> jc.Patterns:
    assert recording.velocity is not None and recording.acceleration is not None
    everything = np.ones(recording.position.shape, bool)
    motion = recording.position, recording.velocity, recording.acceleration
    return jc.Patterns(recording.time, *motion, recording.torque, everything, everything)


def assert_same(fit: jc.Identification, other: jc.Identification) -> None:
    assert_allclose(fit.k, other.k, atol=_ROUNDING)
    assert_allclose(fit.standard_error, other.standard_error, rtol=1e-8)
    assert_array_equal(fit.equations, other.equations)


def test_the_fit_is_that_of_one_process(
    arm: jc.CSLC, recordings: list[jc.Recording], paths: list[Path], client: Client
) -> None:
    seen: list[str] = []
    fit = jc.least_squares.fit_on_cluster(arm, paths, client=client, progress=seen.append)
    whole = joined_patterns([as_recorded(recording) for recording in recordings])
    assert_same(fit, jc.LeastSquares(errors="independent").fit(arm, whole))
    assert seen == [f"{number} of {FILES} files" for number in range(1, FILES + 1)]
    backwards = jc.least_squares.fit_on_cluster(arm, paths[::-1], client=client)
    assert_same(fit, backwards)


@pytest.mark.parametrize("cutoff", [None, 8.0])
def test_settings_prepare_every_file(
    arm: jc.CSLC,
    recordings: list[jc.Recording],
    paths: list[Path],
    client: Client,
    cutoff: float | None,
) -> None:
    """Also with a parallel filter, which is the worker's as well."""
    settings = jc.Settings(solver=jc.LeastSquares(cutoff=cutoff))
    fleet = jc.least_squares.fit_fleet_on_cluster(arm, paths, settings, client=client)
    assert list(fleet.fits) == [str(path) for path in paths]
    for fit, recording in zip(fleet.fits.values(), recordings, strict=True):
        solver = jc.LeastSquares(errors="independent", cutoff=cutoff)
        assert_same(fit, solver.fit(arm, settings.patterns(recording)))


def test_a_fleet_is_a_table(
    arm: jc.CSLC, paths: list[Path], client: Client, tmp_path: Path
) -> None:
    fleet = jc.least_squares.fit_fleet_on_cluster(arm, paths, client=client)
    fleet.save(tmp_path / "fleet.csv")
    with (tmp_path / "fleet.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["file"] for row in rows] == [str(path) for path in paths]
    assert {row["result"] for row in rows} == {"successful"}
    values = np.array([[float(row[name]) for name in arm.names] for row in rows])
    assert_array_equal(values, [fit.k for fit in fleet.fits.values()])
    assert_array_equal(fleet.to_pandas()[list(arm.names)], values)
    # Each robot is a tenth further on.
    assert_allclose(np.diff(values, axis=0), np.full((FILES - 1, arm.size), 0.1), atol=0.1)


class KillsItsWorker:
    """Reads a file, but kills the process that does so for the first time."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __call__(self, path: Path) -> jc.Recording:
        if path.name == "day2.parquet" and not self.marker.exists():
            self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return jc.load_recording(path)


def test_a_killed_worker_changes_nothing(arm: jc.CSLC, paths: list[Path], tmp_path: Path) -> None:
    settings, marker = jc.Settings(), tmp_path / "killed"
    options: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(n_workers=2, silence_logs=50, **options) as cluster, Client(cluster) as busy:
        fit = jc.least_squares.fit_on_cluster(
            arm, paths, settings, client=busy, read=KillsItsWorker(marker)
        )
    assert marker.exists()
    work = Work(jc.least_squares.Derivation.of(arm), settings)
    factors = [block_factors(str(path), work) for path in paths]
    joined = jc.least_squares.joined_factors(factors)
    assert_same(fit, jc.LeastSquares(errors="independent").fit_factors(arm, joined))


def test_messages(arm: jc.CSLC, paths: list[Path], client: Client, tmp_path: Path) -> None:
    fit_on_cluster = jc.least_squares.fit_on_cluster
    with pytest.raises(ValueError, match="there are no files to fit"):
        fit_on_cluster(arm, [], client=client)
    robust = jc.Settings(solver=jc.LeastSquares(loss="huber"))
    with pytest.raises(ValueError, match="expected loss 'squared', got 'huber'"):
        fit_on_cluster(arm, paths, robust, client=client)
    recording = jc.load_recording(paths[0])
    plain = tmp_path / "plain.parquet"
    jc.save_recording(jc.Recording(recording.time, recording.position, recording.torque), plain)
    with pytest.raises(ValueError, match=r"plain\.parquet: has no velocities and accelerations"):
        fit_on_cluster(arm, [plain], client=client)


ROBOT = """
name = "arm"
gravity = [0, -9.81, 0]
friction = ["viscous", "dry"]
[[joint]]
[[joint]]
a = 0.5
"""


def test_command(paths: list[Path], client: Client, tmp_path: Path) -> None:
    """A pattern, and the address of a cluster; one fit, and one a recording."""
    assert client.scheduler is not None
    robot, settings, out = (tmp_path / name for name in ("arm.toml", "settings.json", "out"))
    robot.write_text(ROBOT)
    settings.write_text('{"threshold_fraction": 0.02}')
    line = ["identify", robot, paths[0].parent / "*.parquet", "--settings", settings, "-o", out]
    line += ["--lengths", "numeric", "--dask", str(client.scheduler.address)]
    result = run(*line)
    assert result.exit_code == 0, result.output
    assert f"{FILES} recordings" in result.output
    assert jc.Identification.load(out / "fit.json").rank > 0
    result = run(*line, "--fleet")
    assert result.exit_code == 0, result.output
    assert "day4.parquet  " in result.output
    assert (out / "fleet.csv").exists()
    for more, message in (
        (["--loss", "huber"], "--loss: not with --dask, which reads each file once"),
        ([tmp_path / "none*.csv"], "no such file; expected recordings"),
    ):
        result = run(*line, *more)
        assert result.exit_code == 2
        assert message in result.output
        assert "not with" not in message or "(docs/scale.md)" in result.output


def listening() -> set[tuple[str, int]]:
    """Addresses and ports at which this process and its children can be reached."""
    this = psutil.Process()
    processes = (this, *this.children(recursive=True))
    connections = [connection for process in processes for connection in process.net_connections()]
    return {(x.laddr.ip, x.laddr.port) for x in connections if x.status == psutil.CONN_LISTEN}


def test_nobody_else_reaches_a_local_cluster(arm: jc.CSLC, paths: list[Path]) -> None:
    """Its scheduler runs the code that it is sent: by TLS, from this machine alone."""
    before, during = listening(), set[tuple[str, int]]()
    schedulers: list[str] = []

    def look(_: str) -> None:
        schedulers.append(distributed.default_client().scheduler_info()["address"])
        during.update(listening())

    jc.least_squares.fit_on_cluster(arm, paths[:2], progress=look)
    assert schedulers[0].startswith("tls://127.0.0.1:")
    assert {address for address, _ in during - before} == {"127.0.0.1"}
