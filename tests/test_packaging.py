"""What the project promises about itself: its pins, its wheel, and who may import whom."""

import ast
import functools
import importlib.metadata
import re
import subprocess
import sys
import tomllib
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


ROOT = Path(__file__).parents[1]

# What every folder may import: modules beside the folders, which import nothing of ours.
COMMON = {
    "_bounded_search",
    "_cache",
    "_display",
    "_environment",
    "_plain_data",
    "_processes",
    "_rank",
    "_scratch",
    "_text_table",
}

# Who may import whom, by folder of `jaxcslc`. What a folder may import, whoever imports that folder
# may import too. A folder that is not named here fails the test: decide where it stands.
LAYERS = {
    "codegen": set[str](),
    "manipulator": set[str](),
    "recordings": set[str](),
    "derivation": {"manipulator"},
    "network": {"codegen", "derivation"},
    "control": {"network"},
    "least_squares": {"network", "recordings"},
    "training": {"network", "recordings"},
    "checks": {"least_squares"},
    "uncertainty": {"least_squares"},
    "bodies": {"uncertainty"},
    "friction": {"uncertainty"},
    "examples": {"servo", "systems"},
    "export": {"bodies", "friction"},
    "instruments": {"bodies", "friction"},
    "likelihood": {"bodies", "friction"},
    "selection": {"checks", "friction"},
    "report": {"instruments", "likelihood", "selection"},
    "excitation": {"report"},
    "identification": {"report"},
    "servo": {"export", "report"},
    "systems": {"report"},
    "payload": {"control", "identification"},
    "cli": {"examples", "excitation", "export", "payload", "servo", "systems"},
}


def below(folder: str) -> set[str]:
    """All folders that `folder` may import, itself included."""
    return {folder}.union(*(below(lower) for lower in LAYERS[folder]))


def sources(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.py"))


@functools.lru_cache(maxsize=1)
def nodes(source: str) -> tuple[ast.AST, ...]:
    """All of a source's syntax tree; the last one is kept, for it is asked for several times."""
    return tuple(ast.walk(ast.parse(source)))


def imported(source: str, package: str) -> Iterator[str]:
    """Absolute dotted names of everything that `source`, a module of `package`, imports.

    `from a import b` gives `a.b`, since `b` may be a module.
    """
    for node in nodes(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package.split(".")[: 1 - node.level or None] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def forbidden_imports(source: str, package: str) -> list[str]:
    """Imports by which a module of `package` breaks the layering, in the order of the source."""
    top_package, _, subpackages = package.partition(".")
    folder = subpackages.partition(".")[0]
    outside = {"tests", "scripts", "notebooks"}
    if top_package == "jaxcslc":
        outside |= {"sim"}
    if folder == "derivation":  # exact algebra
        outside |= {"jax", "jaxlib", "equinox"}

    def is_forbidden(name: str) -> bool:
        top, second = (*name.split("."), "")[:2]
        climbs = (
            bool(folder)
            and top_package == top == "jaxcslc"
            and second not in {*below(folder), *COMMON}
        )
        return top in outside or climbs

    return [name for name in imported(source, package) if is_forbidden(name)]


def configures_jax(source: str) -> bool:
    """Whether a module changes JAX's global configuration: `jax.config.update(...)` or by name."""
    return any(
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "update"
        and ast.unparse(node.func.value).split(".")[-1] == "config"
        for node in nodes(source)
    )


def package_of(path: Path) -> str:
    return ".".join(path.parent.relative_to(ROOT).parts)


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    named = (line.split("==") for line in lines if line and not line.startswith("#"))
    return {canonicalize_name(name): version for name, version in named}


def pyproject() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def requirements() -> list[Requirement]:
    """Everything that pyproject.toml asks for: to run, with every extra, to build and to test."""
    table = pyproject()
    groups = [
        line
        for group in table["dependency-groups"].values()
        for line in group
        if isinstance(line, str)  # the rest are tables that include another group
    ]
    project = table["project"]
    extras = [line for lines in project["optional-dependencies"].values() for line in lines]
    lines = [*table["build-system"]["requires"], *project["dependencies"], *extras, *groups]
    return [r for r in map(Requirement, lines) if r.name != project["name"]]


def closure(wanted: Iterable[Requirement]) -> set[str]:
    """Names of all packages needed on this platform, by the metadata of what is installed."""
    seen: set[tuple[str, str]] = set()
    open_ = [(canonicalize_name(r.name), extra) for r in wanted for extra in ("", *r.extras)]
    while open_:
        name, extra = item = open_.pop()
        if item in seen:
            continue
        seen.add(item)
        for line in importlib.metadata.requires(name) or []:
            need = Requirement(line)
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                open_ += [(canonicalize_name(need.name), x) for x in ("", *need.extras)]
    return {name for name, _ in seen}


def test_every_constraint_is_a_name_and_a_version() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = [line for line in lines if not line.startswith("#")]
    odd = [
        line for line in pinned if not re.fullmatch(r"[a-z0-9][a-z0-9-]*==[0-9][0-9a-z.]*", line)
    ]
    assert odd == []
    assert len(pinned) == len(pins()), "a package is pinned twice"
    assert "://" not in "".join(lines), "a comment names a host"


def test_constraints_pin_every_dependency_within_its_range() -> None:
    assert {r.name for r in requirements() if canonicalize_name(r.name) not in pins()} == set()
    outside = {
        str(r)
        for r in requirements()
        if not r.specifier.contains(pins()[canonicalize_name(r.name)], prereleases=True)
    }
    assert outside == set()


def test_constraints_pin_what_the_dependencies_need() -> None:
    assert closure(requirements()) - pins().keys() == set()


def test_every_dependency_has_a_range() -> None:
    assert [str(r) for r in requirements() if ">=" not in str(r.specifier)] == []


def test_version_is_the_installed_one() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert importlib.metadata.version("jaxcslc") == project["version"]


def test_version_is_read_from_the_metadata() -> None:
    """The number is written in pyproject.toml alone."""
    assigned = [
        str(path.relative_to(ROOT))
        for package in ("jaxcslc", "sim")
        for path in sources(ROOT / package)
        if re.search(r"""__version__\s*(:.*)?=\s*["']""", path.read_text())
    ]
    assert assigned == []


def test_wheel_holds_both_packages_whole(tmp_path: Path) -> None:
    """Robot files, `py.typed`, the command and the pages are in the wheel, and nothing else."""
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (path,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(path) as wheel:
        names = set(wheel.namelist())
        (entry,) = (name for name in names if name.endswith("/entry_points.txt"))
        assert "jaxcslc = jaxcslc.cli:main" in wheel.read(entry).decode()
    packaged = {
        name.partition(".data/data/")[2] or name for name in names if ".dist-info/" not in name
    }
    folders = {"jaxcslc": "jaxcslc", "sim": "sim", "docs": "share/doc/jaxcslc"}
    expected = {
        f"{packed}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, packed in folders.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packaged == expected
    assert {"jaxcslc/py.typed", "sim/py.typed"} <= packaged


@pytest.mark.parametrize("package", ["jaxcslc", "sim"])
def test_imports_keep_the_layering(package: str) -> None:
    wrong = {
        str(path.relative_to(ROOT)): names
        for path in sources(ROOT / package)
        if (names := forbidden_imports(path.read_text(), package_of(path)))
    }
    assert wrong == {}


def test_every_folder_has_its_layer() -> None:
    folders = {path.parent.name for path in (ROOT / "jaxcslc").glob("*/*.py")}
    assert folders - LAYERS.keys() == set()


@pytest.mark.parametrize(
    ("package", "source", "allowed"),
    [
        ("jaxcslc.network", "from ..manipulator import Manipulator", True),
        ("jaxcslc.network", "from ._tables import Table", True),
        ("jaxcslc.manipulator", "from .._environment import require", True),
        ("jaxcslc.identification", "from jaxcslc.derivation import derive", True),
        ("jaxcslc.derivation", "import sympy", True),
        ("jaxcslc", "from .cli import main", True),
        ("sim", "import jaxcslc", True),
        ("jaxcslc.manipulator", "from ..motion import Recording", False),
        ("jaxcslc.recordings", "from .. import manipulator", False),
        ("jaxcslc.recordings", "import jaxcslc", False),
        ("jaxcslc.network", "import jaxcslc.identification._direct", False),
        ("jaxcslc.training", "from jaxcslc import control", False),
        ("jaxcslc.identification.deeper", "from ...control import Pid", False),
        ("jaxcslc.network", "def late():\n    from ..identification import fit", False),
        ("jaxcslc.derivation", "import jax.numpy as jnp", False),
        ("jaxcslc", "import sim", False),
        ("jaxcslc.control", "from sim._mjcf import mjcf", False),
        ("sim", "from tests.conftest import rng", False),
    ],
)
def test_the_layering_is_read_from_the_source(package: str, source: str, allowed: bool) -> None:
    assert (forbidden_imports(source, package) == []) is allowed


def test_only_the_command_line_and_enable_x64_configure_jax() -> None:
    touching = {
        str(path.relative_to(ROOT))
        for path in sources(ROOT / "jaxcslc")
        if configures_jax(path.read_text())
    }
    assert touching <= {"jaxcslc/cli/_app.py", "jaxcslc/_environment.py"}  # `enable_x64`


@pytest.mark.parametrize(
    ("source", "configures"),
    [
        ("import jax\njax.config.update('jax_enable_x64', True)", True),
        ("from jax import config\nconfig.update('jax_enable_x64', True)", True),
        ("table.update(config)", False),
        ("x = jax.config.jax_enable_x64", False),
    ],
)
def test_configuring_is_read_from_the_source(source: str, configures: bool) -> None:
    assert configures_jax(source) is configures


def distributions(lines: Iterable[str]) -> set[str]:
    return {canonicalize_name(Requirement(line).name) for line in lines}


def required_modules(source: str) -> Iterator[tuple[str, str]]:
    """What `source` loads through `require(module, extra)`: the module and its extra."""
    for node in nodes(source):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id == "require"
            and len(node.args) == 2
        ):
            module, extra = map(ast.literal_eval, node.args)
            yield module, extra


def type_checking_only(source: str) -> set[str]:
    """Names that `source` imports for annotations alone, below `if TYPE_CHECKING:`."""
    hints = Counter(
        name
        for node in nodes(source)
        if isinstance(node, ast.If)
        and isinstance(node.test, (ast.Name, ast.Attribute))
        and ast.unparse(node.test).endswith("TYPE_CHECKING")
        for name in imported(ast.unparse(ast.Module(node.body, [])), "")
    )
    if not hints:
        return set()
    everywhere = Counter(imported(source, ""))
    return {name for name, count in hints.items() if everywhere[name] == count}


def test_every_dependency_is_imported_and_every_import_declared() -> None:
    """The base by `import`; an extra's libraries by `require`, or by `sim`, which requires them."""
    project = pyproject()["project"]
    base = distributions(project["dependencies"])
    extras = {
        name: distributions(lines) for name, lines in project["optional-dependencies"].items()
    }
    of_module = importlib.metadata.packages_distributions()

    def distribution(module: str) -> set[Any]:
        top, second = (*module.split("."), "")[:2]
        # MuJoCo's package for GPUs installs into MuJoCo's folder.
        if (top, second) == ("mujoco", "mjx"):
            return {"mujoco-mjx"}
        names = {canonicalize_name(name) for name in of_module.get(top, ())}
        return {"mujoco"} if any(name.startswith("mujoco-core") for name in names) else names

    wrong: list[str] = []
    used: set[str] = set()
    for package in ("jaxcslc", "sim"):
        allowed = base.union(*(extras[e] for e in ("sim", "mjx", "film") if package == "sim"))
        for path in sources(ROOT / package):
            source = path.read_text()
            for module, extra in required_modules(source):
                names = distribution(module)
                used |= names
                if not names <= extras[extra]:
                    wrong.append(f"{path.relative_to(ROOT)}: {module} is not in {extra}")
            hints = type_checking_only(source)
            for module in set(imported(source, package_of(path))) - hints:
                top = module.split(".")[0]
                if top in sys.stdlib_module_names or top in ("jaxcslc", "sim"):
                    continue
                names = distribution(module)
                used |= names
                if not names & allowed:
                    wrong.append(f"{path.relative_to(ROOT)}: {module} is not declared")
    assert wrong == []
    ours = canonicalize_name(project["name"])
    asked = base.union(*extras.values()) - {ours}
    # jax brings jaxlib; sympy finds python-flint by itself, and distributed cryptography. Notebooks
    # draw by matplotlib.
    assert asked - used <= {"python-flint", "cryptography", "matplotlib"}


# What needs an extra, and the extra.
NEEDS_AN_EXTRA = {
    "jaxcslc.puma560().to_pandas()": ("pandas", "tables"),
    "jaxcslc.load_robot('tests/data/puma560.xml')": ("mujoco", "urdf"),
    "import sim": ("mujoco", "sim"),
    "from jaxcslc.recordings.files import _bag; next(_bag._opened(_bag.Path('log.bag')).gen)": (
        "rosbags.highlevel",
        "bags",
    ),
    "from jaxcslc.bodies import _nearest_bodies as s; s._conic_solver()": ("clarabel", "inertia"),
}


def test_a_missing_extra_is_named_with_the_command_that_installs_it() -> None:
    """With the libraries out of reach, in a process of its own; the package imports without."""
    program = (
        "import sys\n"
        "missing = ('pandas', 'mujoco', 'clarabel', 'rosbags')\n"
        "sys.modules.update(dict.fromkeys(missing))\n"
        "import jaxcslc\n"
        f"for code in {list(NEEDS_AN_EXTRA)!r}:\n"
        "    try:\n"
        "        exec(code)\n"
        "    except ImportError as error:\n"
        "        print(error)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert run.stdout.splitlines() == [
        f"{module} is not installed: pip install 'jaxcslc[{extra}]'"
        for module, extra in NEEDS_AN_EXTRA.values()
    ]


def test_importing_the_library_leaves_everything_as_it_was() -> None:
    """No output, no change of JAX's configuration, nothing heavy that most users do not need."""
    program = (
        "import sys; import jaxcslc; assert 'jax' not in sys.modules; "
        "import jax; before = dict(jax.config.values); "
        "from importlib.util import find_spec; "
        "others = [name for name in dir(jaxcslc) if not find_spec('jaxcslc.' + name)]; "
        "of_systems = {name for name in others if 'ystem' in name}; "
        "names = [getattr(jaxcslc, name) for name in others if name not in of_systems]; "
        "assert len(names) >= 50; "
        "assert dict(jax.config.values) == before; "
        "heavy = {'sim', 'mujoco', 'matplotlib', 'cvxpy', 'clarabel', 'pandas', 'tomlkit', "
        "'sympy', 'optimistix', 'scipy.interpolate', 'scipy.optimize', 'scipy.signal', "
        "'scipy.special', 'tqdm', 'jaxcslc.training', 'jaxcslc.training'}; "
        "assert not heavy & sys.modules.keys(), heavy & sys.modules.keys(); "
        "assert len([getattr(jaxcslc, name) for name in of_systems]) >= 6; "  # made of SymPy
        "assert heavy & sys.modules.keys() == {'sympy'}, heavy & sys.modules.keys(); "
        "assert dict(jax.config.values) == before; "
        "assert jaxcslc.training.train and jaxcslc.training.AdaptiveNetwork"
    )
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], cwd=ROOT, capture_output=True, text=True
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


def test_the_table_of_contributing_lists_who_may_import_whom() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    rows = re.findall(r"^\| `jaxcslc/(\w+)` \|.*\| ([^|]*) \|$", text, re.MULTILINE)
    listed = {folder: set(re.findall(r"`(\w+)`", lower)) for folder, lower in rows}
    assert listed == LAYERS


def test_the_map_of_contributing_names_files_and_functions_that_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    paths = re.findall(r"`((?:jaxcslc|sim|scripts|tests|docs)/[\w/.-]+)`", text)
    assert len(paths) > 50 and [path for path in paths if not (ROOT / path).exists()] == []
    for name, path in re.findall(r"`(\w+)` in `(\w+/[\w/.-]+\.py)`", text):
        assert re.search(rf"\b{name}\b", (ROOT / path).read_text("utf-8")), (name, path)
