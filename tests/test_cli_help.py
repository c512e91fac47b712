"""Help of the command: groups of options, old names, defaults, errors of usage, completion."""

import json
import math
import shutil
import subprocess
from pathlib import Path

import pytest

from jaxcslc.cli._app import COMMANDS, SUMMARIES, command_named
from jaxcslc.cli._help import grouped, option_text
from tests.conftest import run


ROOT = Path(__file__).parents[1]
MOST_FOR_EVERYONE = 9


def usage_error(*words: str) -> str:
    """The one line that a wrong command line ends in, without the help and page at its end."""
    result = run(*words)
    assert result.exit_code == 2 and result.stdout == ""
    (line,) = result.stderr.strip().splitlines()
    text, _, hint = line.partition(" (")
    help_words, _, page = hint.removesuffix(")").partition("; ")
    assert help_words.startswith("jaxcslc") and help_words.endswith("--help")
    assert (ROOT / page).is_file()
    return text.removeprefix("jaxcslc: ")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_few_options_and_names_the_others(name: str) -> None:
    command = command_named(name)
    groups = grouped(command.parameters)
    everyone = groups.get("", [])
    assert len(everyone) <= MOST_FOR_EVERYONE
    text = run(name, "--help").output
    assert text.startswith(f"usage: jaxcslc {name}")
    shown = [line for line in text.splitlines() if line.startswith(("  -", "  --"))]
    assert len(shown) == len(everyone)
    words = text.replace(",", " ").split()
    for group, options in groups.items():
        assert not group or {group, *(some.typed[2:] for some in options)} <= set(words)
    for line in command.examples:
        assert f"  jaxcslc {line}" in text
    assert text.endswith(f"documentation: docs/{command.page}.md\n")


@pytest.mark.parametrize("name", COMMANDS)
def test_each_group_can_be_shown_and_all_together(name: str) -> None:
    groups = grouped(command_named(name).parameters)
    everything = run(name, "--help-all").output
    for group, options in groups.items():
        part = run(name, "--help", group).output if group else run(name, "--help").output
        for some in options:
            assert option_text(some) in part and option_text(some) in everything
            assert some.option.help.endswith(".")


def test_help_of_the_program_fits_its_summaries() -> None:
    text = run("--help").output
    for summaries in SUMMARIES.values():
        for name, summary in summaries.items():
            assert any(
                line.split()[:1] == [name] and line.endswith(summary) for line in text.splitlines()
            )
    assert run().output == text


def test_pages_and_examples_of_help_exist() -> None:
    for name in COMMANDS:
        command = command_named(name)
        assert (ROOT / "docs" / f"{command.page}.md").exists()
        known = {text for some in command.parameters for text in some.names}
        for line in command.examples:
            assert line.split()[0] == name
            assert {word for word in line.split() if word.startswith("-")} <= known


def test_units_and_tables_in_brackets_are_kept() -> None:
    text = " ".join(run("identify", "--help-all").output.split())
    assert "[s from their start]" in text and "with [equations]" in text
    assert "[fast]" in text  # a default


def test_wrong_usage_is_one_line() -> None:
    assert usage_error("identfy") == "no command 'identfy'; did you mean identify?"
    assert usage_error("check", "--help", "robots").endswith("got 'robots'; did you mean robot?")
    wrong = {
        ("--physicl", "auto"): "no such option: --physicl; did you mean --physical?",
        ("--loss", "cubic"): "--loss: expected squared, huber, bisquare, got 'cubic'",
        ("--loss", "huber", "--loss", "huber"): "--loss: given 2 times, expected once",
        ("--decimate", "0"): "--decimate: expected a whole number from 1 on, got '0'",
        ("--memory", "much"): "--memory: expected a number above 0, got 'much'",
        ("--settings",): "--settings: expected one argument",
        ("--between", "1"): "--between: expected START,END in s, as in 0,8.5, got '1'",
        ("--coupled", "1"): "--coupled: expected two joints, as in 5,6, or 5,6,-1, got '1'",
    }
    for words, text in wrong.items():
        assert usage_error("identify", "puma560", "log.csv", *words) == text
    assert usage_error("compare", "a") == "missing B; expected A B"
    assert usage_error("compare", "a", "b", "c") == "unexpected 'c'; expected A B"
    assert usage_error("payload", "panda", "log.csv") == "missing --previous FILE"
    assert usage_error("example", "kuka") == "ARM: expected panda, puma560, so101, ur5, got 'kuka'"


def test_options_are_checked_before_files_are_read() -> None:
    """The recording is missing, and the robot: what is wrong with the options is said."""
    for robot in ("puma560", "none.urdf"):
        line = run("identify", robot, "none.csv", "--friction", "sticky").stderr
        assert line.startswith("jaxcslc: --friction: unknown friction term 'sticky'")
        assert line.endswith("(docs/friction.md)\n")
    wrong = {
        ("--memory", "0"): "--memory: expected a number above 0, got '0'",
        ("--torque-lag", "nan"): "--torque-lag: expected a number, got 'nan'",
        ("--between", "5,1"): "--between: expected START before END, got '5,1'",
        ("--ml-spacing", "3"): "--ml-spacing: cannot be combined with --estimator least-squares",
        ("--estimator", "auto", "--offsets"): "--offsets: cannot be combined with --estimator auto",
    }
    for words, text in wrong.items():
        assert usage_error("identify", "none.urdf", "none.csv", *words) == text
    wrong = {
        ("--duration", "-1"): "--duration: expected a number above 0, got '-1'",
        ("--torque-noise", "0.1,-1"): "torque noise is [0.1, -1.0]; expected numbers above 0",
    }
    for words, text in wrong.items():
        assert run("excite", "none.urdf", *words).stderr.startswith(f"jaxcslc: {text} (")
    for words in (("-o", "out.toml"), ("--c", "-o", "out.urdf")):
        assert "expected a name ending in" in usage_error("export", "none.urdf", "none", *words)
    line = run("identify", "none.urdf", "none.csv", "--friction", "coulomb").stderr
    assert line.startswith("jaxcslc: none.urdf: no such")  # Coulomb friction is `dry`


def test_errors_name_the_page_of_what_they_are_about(tmp_path: Path) -> None:
    """One line each, by the module that found it; without one, the command's own page."""
    (tmp_path / "odd.csv").write_text("a,b\n1,2\n")
    (tmp_path / "limits.toml").write_text("joint = 1")
    system = tmp_path / "system.toml"
    system.write_text("[equations]\n")
    (tmp_path / "arm.toml").write_text("gravity = [0, -9.81, 0]\n[[joint]]\n")
    (tmp_path / "prior.toml").write_text("[links.1]\nmass = 1.0\n")
    rows = [f"{0.01 * i},{math.sin(0.1 * i)},{math.cos(0.1 * i)}" for i in range(100)]
    (tmp_path / "log.csv").write_text("\n".join(["time,q1,tau1", *rows]))
    files = [str(tmp_path / name) for name in ("arm.toml", "log.csv")]
    prior = ("--prior", str(tmp_path / "prior.toml"), "--physical", "never")
    pages = {
        ("check", "panda", "none.csv"): "recordings",
        ("check", "none.urdf", "none.csv"): "robots",
        ("check", "panda", str(tmp_path / "odd.csv")): "recordings",
        ("identify", "panda", "none.csv", "--settings", "none.json"): "recordings",
        ("excite", "panda", "--limits", str(tmp_path / "limits.toml")): "excitation",
        ("export", "panda", "none"): "report",
        ("example", "panda", "-o", str(tmp_path)): "tutorial",
        ("check", "panda", "a.csv", "a.csv", "--mimic", "fix"): "checks",
        ("identify", "panda", "a.csv", "--dask", "local", "--loss", "huber"): "scale",
        ("identify", str(system), "a.csv", "b.csv"): "systems",
        ("identify", *files, *prior, "-o", str(tmp_path / "out")): "uncertainty",
    }
    for words, page in pages.items():
        result = run(*words)
        assert result.exit_code == 2 and len(result.stderr.splitlines()) == 1
        assert result.stderr.endswith(f" (docs/{page}.md)\n"), words


def test_addresses_open_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sources are beside these tests, whatever the current folder is."""
    for folder in (ROOT, tmp_path):
        monkeypatch.chdir(folder)
        address = run("check", "--help").stdout.rpartition("documentation: ")[2].strip()
        assert address.endswith("docs/checks.md") and Path(address).is_file()
    line = run("check", "panda", "none.csv").stderr
    assert Path(line.rpartition("(")[2].rstrip(")\n")).is_file()


def test_results_are_json_or_nothing(tmp_path: Path) -> None:
    example = run("example", "ur5", "-o", tmp_path / "ur5", "--json")
    assert len(json.loads(example.stdout)["files"]) == 4
    derived = json.loads(run("derive", "puma560", "--json").stdout)
    assert (derived["files"], len(derived["coefficients"])) == ([], 43)
    log = tmp_path / "ur5" / "train.csv"
    checked = json.loads(run("check", tmp_path / "ur5" / "ur5.urdf", log, "--json").stdout)
    assert checked["findings"] == [] and len(checked["recordings"][0]["joints"]) == 6
    assert run("derive", "puma560", "-q").output == ""
    quiet = run("check", "panda", "none.csv", "--quiet")
    assert quiet.stdout == "" and "none.csv" in quiet.stderr


def test_options_of_before_are_understood() -> None:
    context = command_named("identify").context(
        ["puma560", "a.csv", "--every", "3", "--possible=never", "--horizon", "--demanded", "b.csv"]
    )
    assert context.values["decimate"] == 3 and context.values["physical"] == "never"
    assert context.values["simulate"] is True and context.values["torque"] == "commanded"
    assert context.values["train"] == [Path("a.csv"), Path("b.csv")]
    assert context.text() == (
        "jaxcslc identify puma560 a.csv b.csv --torque commanded --physical never --simulate"
        " --decimate 3"
    )
    excite = command_named("excite").context(
        ["panda", "--prior", "results", "--for", "kd5", "--reach", "5", "--estimator", "regression"]
    )
    assert excite.values["previous"] == Path("results") and excite.values["target"] == 5.0
    assert excite.values["estimator"] == "least-squares"
    assert command_named("constants").name == "torque-constants"


def test_negative_numbers_are_values() -> None:
    context = command_named("excite").context(["panda", "--start", "-0.5,1", "--seed", "-3"])
    assert (context.values["start"], context.values["seed"]) == ("-0.5,1", -3)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "tcsh"])
def test_completion_names_commands_and_options(shell: str, tmp_path: Path) -> None:
    pytest.importorskip("shtab")
    result = run("completion", shell)
    assert result.exit_code == 0, result.output
    for word in (*COMMANDS, "quality", "decimate", "torque-lag", "maximum-likelihood"):
        assert word in result.stdout
    for word in ("--every", "likelihood-every", "demanded"):  # names of before
        assert word not in result.stdout
    if program := shutil.which(shell):
        script = tmp_path / "script"
        script.write_text(result.stdout, "utf-8")
        subprocess.run([program, "-n", str(script)], check=True)
