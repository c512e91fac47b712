"""References: which commands are run, and how much the numbers that they write may differ."""

from typing import NamedTuple


class Limits(NamedTuple):
    """What two numbers may differ by: coefficients in standard errors, others relatively."""

    errors: float
    relative: float


DIRECT = Limits(1e-9, 1e-7)
SEARCHED = Limits(1e-3, 1e-3)


class Reference(NamedTuple):
    """Commands that are run one after another in a folder of their own.

    **Attributes**

    - `name`: of the folder.
    - `commands`: lines for `jaxcslc`.
    - `limits`: of numbers in what they write.
    - `real`: folder of the real recordings that they read, if any.
    """

    name: str
    commands: tuple[str, ...]
    limits: Limits = DIRECT
    real: str | None = None


_A = "identify puma560 ../inputs/puma_a.csv"
_VALIDATE_A = "--validate ../inputs/puma_a_validation.csv"
_ARM = "../inputs/{0}.toml ../inputs/{0}.csv"

REFERENCES = (
    Reference(
        "puma_a",
        (
            f"{_A} {_VALIDATE_A} -o identified",
            "export puma560 identified -o robot.toml",
            "export puma560 identified --c -o model.c",
        ),
    ),
    Reference(
        "puma_b",
        (
            "identify puma560 ../inputs/puma_b.csv --validate ../inputs/puma_b_validation.csv"
            " -o identified",
            "export puma560 identified -o robot.toml",
            "export puma560 identified --c -o model.c",
        ),
    ),
    Reference(
        "puma_b_mjcf",
        (
            "identify ../inputs/puma560.xml ../inputs/puma_b.csv -o identified",
            "export ../inputs/puma560.xml identified -o robot.xml",
            "export ../inputs/puma560.xml identified --no-motors -o robot_without_motors.xml",
            "export ../inputs/puma560.xml identified --c -o model.c",
        ),
    ),
    Reference(
        "kr300",
        (
            "identify ../inputs/kuka_kr300/kr300.toml ../inputs/kuka_kr300/A.csv"
            " --validate ../inputs/kuka_kr300/B.csv -o identified",
            "export ../inputs/kuka_kr300/kr300.toml identified -o robot.toml",
            "export ../inputs/kuka_kr300/kr300.toml identified --c -o model.c",
        ),
        real="kuka_kr300",
    ),
    Reference(
        "panda",
        (
            "identify panda ../inputs/franka_panda/training.csv"
            " --validate ../inputs/franka_panda/validation.csv"
            " --columns ../inputs/franka_panda/columns.toml --friction viscous,dry,offset"
            " --measured -o identified",
            "export panda identified --force -o robot.toml",
            "export panda identified --force --c -o model.c",
        ),
        real="franka_panda",
    ),
    Reference(
        "tx40",
        (
            "identify tx40 ../inputs/staubli_tx40/training.csv"
            " --validate ../inputs/staubli_tx40/validation.csv --measured -o identified",
            "export tx40 identified -o robot.toml",
            "export tx40 identified --c -o model.c",
        ),
        SEARCHED,
        real="staubli_tx40",
    ),
    Reference(
        "lwr4",
        (
            "identify ../inputs/kuka_lwr4/kuka_lwr4.urdf ../inputs/kuka_lwr4/hw1.csv"
            " --validate ../inputs/kuka_lwr4/hw3.csv -o identified",
            "export ../inputs/kuka_lwr4/kuka_lwr4.urdf identified -o robot.urdf",
            "export ../inputs/kuka_lwr4/kuka_lwr4.urdf identified --no-motors"
            " -o robot_without_motors.urdf",
            "export ../inputs/kuka_lwr4/kuka_lwr4.urdf identified --c -o model.c",
        ),
        real="kuka_lwr4",
    ),
    Reference(
        "lwr4_prior",
        (
            "identify ../inputs/kuka_lwr4/kuka_lwr4.urdf ../inputs/kuka_lwr4/hw1.csv"
            " --validate ../inputs/kuka_lwr4/hw3.csv --prior ../inputs/kuka_lwr4/prior.toml"
            " -o identified",
        ),
        real="kuka_lwr4",
    ),
    Reference(
        "several",
        (
            f"{_A} ../inputs/puma_a_second.csv {_VALIDATE_A} --offsets -o identified",
            "export puma560 identified -o robot.toml",
        ),
    ),
    Reference(
        "likelihood",
        (
            f"{_A} {_VALIDATE_A} --estimator maximum-likelihood -o identified",
            "export puma560 identified -o robot.toml",
        ),
        SEARCHED,
    ),
    Reference(
        "instruments", (f"{_A} --estimator instrumental-variables -o identified",), SEARCHED
    ),
    Reference(
        "pre_sliding",
        (
            f"identify {_ARM.format('pre_sliding')} --friction auto --simulate -o identified",
            "export ../inputs/pre_sliding.toml identified -o robot.toml",
            "export ../inputs/pre_sliding.toml identified --c -o model.c",
        ),
        SEARCHED,
    ),
    Reference(
        "load_friction",
        (
            f"identify {_ARM.format('load_friction')} -o identified",
            "export ../inputs/load_friction.toml identified --c -o model.c",
        ),
        SEARCHED,
    ),
    Reference(
        "static_friction",
        (f"{_A} {_VALIDATE_A} --friction viscous,dry,static -o identified",),
        SEARCHED,
    ),
    Reference(
        "coupled",
        (
            f"identify {_ARM.format('coupled')} -o identified",
            "export ../inputs/coupled.toml identified -o robot.toml",
            "export ../inputs/coupled.toml identified --c -o model.c",
        ),
    ),
    Reference(
        "reidentified",
        (
            f"{_A} -o identified",
            "identify puma560 ../inputs/puma_a_second.csv --reidentify viscous,dry"
            " --previous identified -o friction",
            "compare identified friction -o comparison.html",
        ),
    ),
    Reference(
        "payload",
        (
            f"{_A} -o identified",
            "payload puma560 ../inputs/puma_a_loaded.csv --previous identified/identification.json"
            " --unloaded ../inputs/puma_a_second.csv -o payload",
        ),
    ),
    Reference(
        "system",
        (
            "derive ../inputs/cart_pole.toml -o derived",
            f"identify {_ARM.format('cart_pole')} -o identified",
        ),
    ),
    Reference(
        "searched_system",
        (f"identify {_ARM.format('tank')} -o identified",),
        SEARCHED,
    ),
    Reference("derived_puma560", ("derive puma560 -o derived",)),
    Reference("derived_panda", ("derive panda -o derived",)),
    Reference("checked", ("check puma560 ../inputs/puma_a.csv ../inputs/puma_a_loaded.csv",)),
    Reference(
        "designed",
        ("excite ../inputs/pre_sliding.toml -o motion.csv --duration 2 --rate 100 --starts 1"
         " --limits ../inputs/limits.toml",),
        SEARCHED,
    ),
)  # fmt: skip
"""All references, in the order in which they are written."""
