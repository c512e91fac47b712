import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..._environment import require
from ...motion import Patterns
from ...network import CSLC
from .._held_out import HeldOut
from .._settings import Settings
from ..checks import DataCheck
from ..friction import PreSlidingFit, SlopeFit, along_motion
from ..likelihood import EstimatorComparison
from ..possible import PhysicalParameters, PossibleFit
from ..prediction import HorizonError
from ..prior import Prior
from ..selection import FrictionChoice, Selection
from ..several import SeveralFit
from ..solver import Identification
from ..systematic import SystematicError
from ._coefficient_table import coefficient_rows, coefficient_text
from ._errors import ErrorTable
from ._excitation import Excitation
from ._report_files import report_document, save_report
from ._report_text import determination_lines, expression_text, held_out_lines, joint_lines
from .page import report_data, summary_text


@dataclasses.dataclass(frozen=True, eq=False)
class Report:
    """The result of `identify`: coefficients, their uncertainty, and torque errors.

    `print` shows what `jaxcslc identify` prints; `save` writes what it writes.

    **Attributes**

    - `network`: with the slopes of static friction that were fitted, if it has static friction.
    - `settings`: of preparation and fit.
    - `fit`: the `Identification`, with standard errors and covariance; its coefficients are those
      of possible bodies if `possible.used`.
    - `patterns`: by recording, `"training"` and, if there was one, `"validation"`.
    - `errors`: torque errors, by recording. The first vector of each `ErrorTable` is `"fit"`; after
      a re-identification the second is `"before"`.
    - `excitation`: of the training recording; None after a re-identification.
    - `held_out`: errors of the validation recording beside those of the training recording; without
      a validation recording by cross-validation within the training recording. None after a
      re-identification without a validation recording.
    - `slopes`: the fit of the slopes of static friction; None if there was none.
    - `systematic`: errors of the fit that no residual shows; None if they were not computed.
    - `groups`: groups or names of the re-identified coefficients; None if all were fitted.
    - `warnings`: one sentence each.
    - `selection`: of the settings, with every trial; None if they were set.
    - `bodies`: possible bodies nearest to the fit, for the page; see `physical_parameters`.
    - `possible`: those bodies beside the free fit, and whether their coefficients are the report's;
      None if they were not computed.
    - `prior`: what was known before; None if nothing was said.
    - `several`: of several training recordings: noise and offsets of each, and whether they agree.
      `patterns["training"]` then holds all of them, one after the other.
    - `judged_part`: in words, the part of a long recording that settings are chosen on and fits
      judged on; None if that is all of it.
    - `data_check`: what was read, and what looks wrong with it; None if it was not checked.
    - `notes`: what readers of the robot and of the recordings decided, one sentence each.
    - `estimators`: least squares and maximum likelihood beside each other; None unless asked for.
    - `horizon`: position error of open-loop simulation; None unless asked for.
    - `friction`: friction terms that were tried joint by joint, pre-sliding included; None unless
      asked for.
    - `pre_sliding`: dry friction that yields before it slides; None unless it was tried and
      predicts motion better that was left out, at one joint at least, or its lengths were given.
      Of least squares, its coefficients are those of a free fit beside `fit`; of maximum
      likelihood, `fit` is of it, and so are all errors of this report (`lengths`).

    >>> import numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(1000)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    >>> recording = jc.Recording(t[:, 0], q, torque)
    >>> report = jc.identify(network, recording, settings=jc.Settings())
    >>> report.to_pandas().index.tolist()
    ['kB1', 'kB2', 'kB3', 'kv1', 'kd1']
    >>> tuple(report.errors)
    ('training',)
    """

    network: CSLC
    settings: Settings
    fit: Identification
    patterns: Mapping[str, Patterns]
    errors: Mapping[str, ErrorTable]
    excitation: Excitation | None = None
    held_out: HeldOut | None = None
    slopes: SlopeFit | None = None
    systematic: SystematicError | None = None
    groups: tuple[str, ...] | None = None
    warnings: tuple[str, ...] = ()
    selection: Selection | None = None
    bodies: PhysicalParameters | None = None
    possible: PossibleFit | None = None
    prior: Prior | None = None
    several: SeveralFit | None = None
    data_check: DataCheck | None = None
    judged_part: str | None = None
    notes: tuple[str, ...] = ()
    estimators: EstimatorComparison | None = None
    horizon: HorizonError | None = None
    friction: FrictionChoice | None = None
    pre_sliding: PreSlidingFit | None = None

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """(p,) identified coefficients, in the order of `network.coefficients`."""
        return self.fit.k

    @property
    def lengths(self) -> Float[np.ndarray, " joints"]:
        """(n,) lengths of pre-sliding that the coefficients go with [rad or m]; 0 where their dry
        friction follows the sign of velocity."""
        if self.estimators is None or self.estimators.used != "maximum-likelihood":
            return np.zeros(self.network.joint_count)
        return self.estimators.likelihood.lengths

    def network_along(self, recording: str) -> CSLC:
        """The network that predicts torque along a recording's motion by the coefficients `k`.

        **Arguments**

        - `recording`: a name in `patterns`.

        **Returns** `network`; where `lengths` are not 0, dry friction has its states along the
        positions of these patterns, so that it is for all of them at a time.
        """
        return along_motion(self.network, self.patterns[recording], self.lengths)

    def rows(self, level: float = 0.95) -> list[dict[str, str | float | bool]]:
        """One row a coefficient: value, interval, verdict and expression; see
        `coefficient_rows`."""
        return coefficient_rows(
            self.network,
            self.fit,
            excitation=self.excitation,
            systematic=self.systematic,
            level=level,
        )

    def to_pandas(self, level: float = 0.95) -> Any:
        """`rows()` as a `pandas.DataFrame` indexed by coefficient.

        **Arguments**

        - `level`: of the confidence intervals.
        """
        pandas = require("pandas", "tables")

        return pandas.DataFrame(self.rows(level)).set_index("name").rename_axis("coefficient")

    def save(
        self,
        folder: str | Path,
        *,
        pictures: bool = True,
        findings: Sequence[str] = (),
        command: str | None = None,
    ) -> tuple[Path, ...]:
        """Writes the report into a folder: all of its files or, if writing fails, none.

        `index.html`, a page to read and to show, in one file; `coefficients.csv`;
        `identification.json`, which `load_report` reads; and for each recording
        `errors_NAME.csv` and `torque_NAME.csv`. Files of these names that an
        earlier report left and this one does not have are removed.

        The page's pictures can be zoomed with the extra `report`; without it they are static, and
        without the extra `plot` too there are none.

        **Arguments**

        - `folder`: is made if it is missing.
        - `pictures`: whether the page has pictures.
        - `findings`: about the recordings, a sentence each, for the page.
        - `command`: that repeats the identification, for the page.

        **Returns** the files.

        **Raises**

        - `ValueError`: `folder` is a file; or the settings have a smoothing that is not
          registered and has no name in a file.
        - `OSError`: the folder cannot be written.
        """
        data = self._data | {"findings": [*findings, *self._findings], "command": command}
        document = report_document(self, data)
        return save_report(Path(folder), self, document, data, pictures=pictures)

    @property
    def verdict(self) -> str:
        """Whether the model can be used, and what that rests on: the first lines of the page."""
        return summary_text(self._data)

    @cached_property
    def _data(self) -> dict[str, Any]:
        """What the page shows."""
        return report_data(
            self,
            selection=self.selection,
            bodies=self.bodies,
            possible=self.possible,
            several=self.several,
            judged_part=self.judged_part,
            estimators=self.estimators,
            horizon=self.horizon,
            friction=self.friction,
            findings=self._findings,
            notes=self.notes,
        )

    @property
    def _findings(self) -> list[str]:
        return [] if self.data_check is None else list(map(str, self.data_check.findings))

    def __repr__(self) -> str:
        return f"Report({self.network.robot.name}; {self.fit!r})"

    def __str__(self) -> str:
        return "\n\n".join("\n".join(section) for section in self._sections() if section)

    def _sections(self) -> Iterator[list[str]]:
        yield [str(self.network), *joint_lines(self.network), f"settings: {self.settings}"]
        if self.judged_part is not None:
            yield [self.judged_part]
        if self.groups is not None:
            yield [
                f"re-identified: {', '.join(self.groups)}; all other coefficients are fixed at"
                " those of the previous identification"
            ]
        if self.prior is not None:
            yield [f"known before: {self.prior}"]
        if self.several is not None:
            yield [str(self.several)]
        yield [coefficient_text(self.rows())]
        if self.slopes is not None and self.network.static_slopes is not None:
            yield [_slopes(self.slopes)]
        yield self._determination()
        for name, table in self.errors.items():
            yield [f"torque error, {name} recording", str(table)]
        yield held_out_lines(self.held_out)
        if self.estimators is not None:
            yield [str(self.estimators)]
        if self.horizon is not None:
            yield ["simulated open loop, median absolute error of positions", str(self.horizon)]
        if self.possible is not None:
            yield [str(self.possible)]
        if self._findings:
            yield [f"warning: {finding}" for finding in self._findings]
        yield [f"warning: {warning}" for warning in self.warnings]
        tried = () if self.friction is None else self.friction.sentences
        yield [f"note: {note}" for note in (*tried, *self.notes)]

    @property
    def fixed_names(self) -> tuple[str, ...]:
        """Coefficients that were not fitted, but kept from a previous identification."""
        if self.groups is None:
            return ()
        return tuple(
            coefficient.name
            for coefficient in self.network.coefficients
            if coefficient.group not in self.groups and coefficient.name not in self.groups
        )

    def _determination(self) -> list[str]:
        fitted = self.network.size - len(self.fixed_names)
        lines = determination_lines(self.fit, fitted, self.excitation, self.systematic)
        return [expression_text(self.network), *lines]


def _slopes(fit: SlopeFit) -> str:
    network = fit.network
    listed = ", ".join(
        f"{name} {slope:.4g} ± {error:.2g}"
        for name, slope, error, terms in zip(
            network.output_names,
            fit.slopes.tolist(),
            fit.slope_error.tolist(),
            network.friction_per_joint,
            strict=True,
        )
        if "static" in terms
    )
    return (
        f"slopes of static friction [s/rad or s/m]: {listed};"
        " the intervals above allow for their errors"
    )
