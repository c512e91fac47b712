"""The report of an identification: a fit, and a list of sections that say all else.

What a report shows is in its sections (`_section.py`, `sections/`); here are the coefficients,
the order of sections, and how reports are written. `load_report` reads them back.
"""

import abc
import copy
import dataclasses
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from jaxtyping import Array, Float

from .._environment import require
from ..friction import along_motion
from ..least_squares import Identification, Settings
from ..manipulator import Manipulator
from ..network import CSLC, AbstractLinearNetwork
from ..recordings import Patterns
from ..uncertainty import standard_uncertainty
from ._charts import Panel, PanelChart
from ._coefficients import CoefficientRow, ModelDescription, coefficient_rows
from ._errors import predicted_torque
from ._files import identification_file, read_files, saved_network, write_report
from ._page import Message, Page, Section, Tone, notebook_frame
from ._section import IDENTIFICATION, AbstractSection, counted
from .sections import SECTIONS, curve_chart


N = TypeVar("N", bound=AbstractLinearNetwork)
R = TypeVar("R", bound="AbstractReport[Any]")

_HEADLINES: dict[Tone, str] = {
    "good": "The identified model can be used.",
    "caution": "The identified model can be used with care: see the points marked !.",
    "bad": "Do not rely on the identified model until the points marked ✗ are resolved.",
}
_MARKS: dict[Tone, str] = {"good": "✓", "caution": "!", "bad": "✗", "plain": " "}


@dataclasses.dataclass(frozen=True, eq=False, repr=False, init=False)
class AbstractReport(abc.ABC, Generic[N]):
    """Coefficients with their uncertainty, and a list of sections.

    Results are attributes by the names that sections give them: `report.held_out`.

    **Attributes**

    - `network`: that was identified.
    - `settings`: of preparation and fit; None of a file without them.
    - `fit`: the `Identification`.
    - `patterns`: by recording; empty of a report that was loaded.
    - `results`: by name, what sections are made of.
    - `document`: what the files hold of a report that was loaded; None of others.
    - `kinds`: of sections, in the order of the text.
    """

    kinds: ClassVar[tuple[type[AbstractSection], ...]]

    network: N
    settings: Settings
    fit: Identification
    patterns: Mapping[str, Patterns]
    results: Mapping[str, Any]
    document: Mapping[str, Any] | None

    def __init__(
        self,
        network: N | None,
        settings: Settings | None,
        fit: Identification,
        patterns: Mapping[str, Patterns],
        results: Mapping[str, Any] = MappingProxyType({}),
        document: Mapping[str, Any] | None = None,
        **named: Any,
    ) -> None:
        """**Arguments**: the attributes; `named`: further results by their names.

        - `network`: None to derive it from `document` when it is asked for.
        """
        if unknown := sorted(named.keys() - {name for kind in self.kinds for name in kind.results}):
            raise TypeError(f"{type(self).__name__}: no section has a result {unknown[0]!r}")
        fields = {"settings": settings, "fit": fit, "patterns": patterns, "document": document}
        fields["results"] = MappingProxyType({**results, **named})
        for name, value in (fields if network is None else {**fields, "network": network}).items():
            object.__setattr__(self, name, value)

    @abc.abstractmethod
    def network_along(self, recording: str) -> N:
        """Return the network that predicts along a recording's motion by `k`."""

    @abc.abstractmethod
    def derived_network(self) -> N:
        """Return the network that `document` describes.

        **Raises** `AttributeError` where it describes none.
        """

    def __getattr__(self, name: str) -> Any:
        if name == "network":
            object.__setattr__(self, name, self.derived_network())
            return self.network
        kind = next((kind for kind in self.kinds if name in kind.results), None)
        if kind is None:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        if name in self.results:
            return self.results[name]
        section = None if self.document is None else kind.from_document(self.document)
        return kind.results[name] if section is None else section.result(name, self)

    @cached_property
    def sections(self) -> tuple[AbstractSection, ...]:
        """Sections of the report, in the order of its text."""
        sections = (
            kind.of(self)
            if self.document is None or self.results.keys() & kind.results.keys()
            else kind.from_document(self.document)
            for kind in self.kinds
        )
        return tuple(section for section in sections if section is not None)

    def section(self, name: str) -> AbstractSection | None:
        """Return the section of a name; None if the report has none."""
        return next((section for section in self.sections if section.name == name), None)

    @cached_property
    def model(self) -> ModelDescription:
        """Names and units of outputs and coefficients."""
        if self.document is not None:
            return ModelDescription.from_document(self.document, self.fit)
        return ModelDescription.of(self.network)

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """(p,) identified coefficients, in the order of `names`."""
        return self.fit.k

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return self.fit.names

    @property
    def covariance(self) -> Float[Array, "coefficients coefficients"]:
        """(p, p) of the coefficients, without systematic errors."""
        return self.fit.covariance

    @property
    def standard_errors(self) -> Float[np.ndarray, " coefficients"]:
        """(p,) standard uncertainty of each coefficient in its unit, systematic errors included."""
        return standard_uncertainty(self.fit, getattr(self, "systematic", None))

    def rows(self, level: float = 0.95) -> list[dict[str, str | float | bool]]:
        """Return one row per coefficient: value, interval, verdict and expression.

        **Arguments**

        - `level`: of the confidence intervals; see `coefficient_rows`.
        """
        return coefficient_rows(
            self.model,
            self.fit,
            excitation=getattr(self, "excitation", None),
            systematic=getattr(self, "systematic", None),
            share=self._file_share,
            level=level,
        )

    @property
    def _file_share(self) -> Float[np.ndarray, " coefficients"] | None:
        weight = getattr(self, "file_prior", None)
        return None if weight is None else weight.share

    def __getitem__(self, name: str) -> CoefficientRow:
        """Return a coefficient's row, with `value`, `error`, `interval`, `unit` and `verdict`.

        **Raises** `KeyError` for a name that no coefficient has.
        """
        if name not in self.names:
            raise KeyError(f"{name}: expected a coefficient, {self.names[0]} to {self.names[-1]}")
        return CoefficientRow(self.rows()[self.names.index(name)])

    def to_pandas(self, level: float = 0.95) -> Any:
        """Return `rows()` as a `pandas.DataFrame` indexed by coefficient.

        **Arguments**

        - `level`: of the confidence intervals.
        """
        pandas = require("pandas", "tables")

        return pandas.DataFrame(self.rows(level)).set_index("name").rename_axis("coefficient")

    def sample(self, n: int, seed: int = 0) -> Float[np.ndarray, "draws coefficients"]:
        """Return coefficients drawn from the normal distribution of `k` and `covariance`, (n, p).

        Combinations that the patterns do not determine stay as they are in `k`.

        **Arguments**

        - `n`: number of draws.
        - `seed`: of the random numbers.
        """
        covariance = np.asarray(self.covariance)
        scale = np.sqrt(np.diag(covariance))
        scale = np.where(scale > 0.0, scale, 1.0)
        variance, directions = np.linalg.eigh(covariance / scale[:, None] / scale)
        root = scale[:, None] * directions * np.sqrt(np.maximum(variance, 0.0))
        draws = np.random.default_rng(seed).normal(size=(n, len(scale)))
        return np.asarray(self.k) + draws @ root.T

    def predicted(self, recording: str) -> Float[np.ndarray, "samples outputs"]:
        """Return the torque, or the known sides, that `k` predicts along a recording."""
        if recording not in self._predicted:
            torque = predicted_torque(
                self.network_along(recording), self.patterns[recording], self.fit.k
            )
            self._predicted[recording] = np.asarray(torque)
        return self._predicted[recording]

    @cached_property
    def _predicted(self) -> dict[str, np.ndarray]:
        return {}

    def page(self, charts: bool = True) -> Page:
        """Return the report as a page for `jaxcslc.report.render`.

        **Arguments**

        - `charts`: whether it has drawings.
        """
        tone, messages = self._judgement
        parts: dict[str, Section] = {}
        shown = [section for section in self.sections if charts or section.file == IDENTIFICATION]
        for section in sorted(shown, key=lambda section: section.position):
            for part in section.blocks(self, charts):
                before = parts.get(part.title, Section(part.title, part.lead, ()))
                blocks = (*before.blocks, *part.blocks)
                parts[part.title] = dataclasses.replace(before, blocks=blocks)
        outputs = counted(len(self.model.output_names), self.model.output_kind)
        return Page(
            title=f"Identification of {self.model.name}",
            subtitle=f"{outputs}, {counted(len(self.names), 'coefficient')}",
            headline=_HEADLINES[tone],
            tone=tone,
            summary=messages,
            sections=tuple(parts.values()),
        )

    @cached_property
    def _judgement(self) -> tuple[Tone, tuple[Message, ...]]:
        """The worst tone, and what it rests on; what is said of the data stands last."""
        ordered = sorted(self.sections, key=lambda part: part.position)
        messages = tuple(message for part in ordered for message in part.messages(self))
        tones = {message.tone for message in messages}
        tone: Tone = "bad" if "bad" in tones else "caution" if "caution" in tones else "good"
        return tone, messages

    @property
    def objections(self) -> tuple[str, ...]:
        """Reasons not to rely on the model: the sentences of the verdict that are marked ✗."""
        return tuple(message.text for message in self._judgement[1] if message.tone == "bad")

    @property
    def verdict(self) -> str:
        """Verdict whether the model can be used, and its reasons: the first lines of the page."""
        tone, messages = self._judgement
        return "\n".join(
            [_HEADLINES[tone], *(f"  {_MARKS[line.tone]} {line.text}" for line in messages)]
        )

    def torque_chart(self, joint: str | int, recording: str | None = None) -> Any:
        """Return a plotly figure of the measured and predicted torque of a joint.

        **Arguments**

        - `joint`: its name, or its number from 1.
        - `recording`: `"training"` or `"validation"`; the latter if there is one and none is named.

        **Raises**

        - `ValueError`: there is no such joint or recording.
        - `ImportError`: the extra `report` is not installed.
        """
        return self._figure(self._torque_charts(recording)[self._output(joint)].panels)

    def plot(self, recording: str | None = None) -> Any:
        """Return a plotly figure of the measured and predicted torque of all joints.

        **Arguments** and **Raises** as of `torque_chart`.
        """
        charts = self._torque_charts(recording)
        return self._figure(tuple(panel for chart in charts for panel in chart.panels))

    def _figure(self, panels: tuple[Panel, ...]) -> Any:
        described = PanelChart(panels, "time [s]", "").plotly_figure()
        return require("plotly.graph_objects", "report").Figure(described)

    def _output(self, joint: str | int) -> int:
        """Return the index of an output by name, or by number from 1."""
        names = self.model.output_names
        if joint in names:
            return names.index(str(joint))
        if not isinstance(joint, int) or not 1 <= joint <= len(names):
            raise ValueError(f"joint: expected 1 to {len(names)} or a name, got {joint!r}")
        return joint - 1

    def _torque_charts(self, recording: str | None) -> list[PanelChart]:
        section = self.section("curves")
        curves = {} if section is None else section.data["curves"]
        name = recording or ("validation" if "validation" in curves else "training")
        if name not in curves:
            known = ", ".join(curves) or "none (the report was saved without pictures)"
            raise ValueError(f"recording: expected one of {known}, got {name!r}")
        return [curve_chart(x, self.model, i, name) for i, x in enumerate(curves[name])]

    def documents(self, charts: bool = True) -> dict[str, dict[str, Any]]:
        """Return what the report's JSON files hold, by their names.

        **Arguments**

        - `charts`: whether to return what only drawings need.
        """
        files = {IDENTIFICATION: {**self.model.document(), **self.fit.document()}}
        for section in self.sections:
            if charts or section.file == IDENTIFICATION:
                files.setdefault(section.file, {}).update(section.data)
        return files

    def save(
        self, folder: str | Path, *, pictures: bool = True, command: str | None = None
    ) -> tuple[Path, ...]:
        """Writes the report into a folder: all of its files or, if writing fails, none.

        `index.html`, a page to read and to show, in one file; `coefficients.csv`;
        `identification.json` and, of the page's drawings, `charts.json`, which `load_report`
        reads; and for each recording `errors_NAME.csv` and `torque_NAME.csv`. Files of these names
        that an earlier report left and this one does not have are removed. A report that was
        loaded has no `torque_NAME.csv` to write.

        The page's pictures need the extra `report`.

        **Arguments**

        - `folder`: is made if it is missing.
        - `pictures`: whether the page has pictures.
        - `command`: that repeats the identification, for the page.

        **Returns** the files, without `charts.json`.

        **Raises**

        - `ValueError`: `folder` is a file; or the settings have a smoothing that is not
          registered and has no name in a file.
        - `OSError`: the folder cannot be written.
        """
        report = self if command is None else self._with_results(command=command)
        return write_report(Path(folder), report, pictures=pictures)

    def _with_results(self, **results: Any) -> "AbstractReport[N]":
        """Return the same with other results; sections that have none of them stay the same."""
        kept = {type(section): section for section in self.sections}
        changed = copy.copy(self)
        object.__setattr__(changed, "results", MappingProxyType({**self.results, **results}))
        sections = (
            kind.of(changed) if results.keys() & kind.results.keys() else kept.get(kind)
            for kind in self.kinds
        )
        vars(changed)["sections"] = tuple(x for x in sections if x is not None)
        return changed

    def __repr__(self) -> str:
        return f"{type(self).__name__} of {self.model.name}. {self.verdict}"

    def __str__(self) -> str:
        paragraphs = (lines for section in self.sections for lines in section.text(self))
        text = ["\n".join(lines) for lines in paragraphs if lines]
        return "\n\n".join([*text, self.verdict])

    def _repr_html_(self) -> str:
        """Return the page without drawings, for notebooks."""
        return notebook_frame(self.page(charts=False))


class Report(AbstractReport[CSLC]):
    """The result of `identify`: coefficients, their uncertainty, and a list of sections.

    `print` shows what `jaxcslc identify` prints; `save` writes what it writes, and `load_report`
    reads it back. A notebook shows the page. `report["kd1"]` is a coefficient with its interval,
    `plot` and `torque_chart` draw measured and predicted torque.

    **Attributes**

    - `network`: with the slopes of static friction that were fitted, if it has static friction.
    - `settings`: of preparation and fit.
    - `fit`: the `Identification`, with standard errors and covariance; its coefficients are those
      of physically consistent bodies if `possible.used`.
    - `patterns`: by recording, `"training"` and, if there was one, `"validation"`; empty of a
      report that was loaded.
    - `motion`: states of the training recording; of a report that was loaded some of them.
    - `sections`: what the report shows.
    - `results`: by name, what sections are made of.
    - `document`: what the files hold of a report that was loaded; None of others.

    Results are attributes by the names that sections give them, None or empty where there are none:
    `errors`, `excitation`, `held_out`, `systematic`, `warnings`, `notes` and others, which
    `docs/report.md` lists with what each is.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> report = jc.identify(network, recording, settings=jc.Settings())
    >>> report.to_pandas().index.tolist()
    ['kB1', 'kB2', 'kB3', 'kv1', 'kd1']
    >>> report["kv1"]
    kv1 = 0.2 N m s/rad, 95 % interval 0.2 to 0.2, well determined up to scale
    >>> round(report["kv1"].value, 3), report["kv1"].unit, tuple(report.errors)
    (0.2, 'N m s/rad', ('training',))
    >>> report.sample(64).shape
    (64, 5)
    """

    kinds: ClassVar[tuple[type[AbstractSection], ...]] = SECTIONS

    @property
    def presliding_distance(self) -> Float[np.ndarray, " joints"]:
        """(n,) distances of pre-sliding that the coefficients go with [rad or m]; 0 where their dry
        friction follows the sign of velocity."""
        section = self.section("estimators")
        data = {} if section is None else section.data["estimators"]
        used = data.get("used") == "maximum-likelihood" and data["lengths"] is not None
        return np.array(data["lengths"]) if used else np.zeros(len(self.model.output_names))

    @property
    def motion(self) -> Patterns | None:
        """Patterns of the training recording; of a report that was loaded, some states of it."""
        return self.patterns["training"] if self.patterns else self.states

    @property
    def fixed_names(self) -> tuple[str, ...]:
        """Coefficients that were not fitted, but kept from a previous identification."""
        section = self.section("groups")
        return () if section is None else tuple(section.data["fixed"])

    def network_along(self, recording: str) -> CSLC:
        """Return the network that predicts torque along a recording's motion by `k`.

        **Arguments**

        - `recording`: a name in `patterns`.

        **Returns** `network`; where `presliding_distance` is not 0, dry friction has its states
        along the positions of these patterns, so that it is for all of them at a time.
        """
        return along_motion(self.network, self.patterns[recording], self.presliding_distance)

    def derived_network(self) -> CSLC:
        """Return the network of the robot that the files describe."""
        return saved_network(self.document or {}, self.fit, "identification.json", None)


def load_report(path: str | Path, robot: Manipulator | None = None) -> Report:
    """Return the report that `Report.save` wrote, or what `Identification.save` did.

    Its sections, coefficients and their covariance are those of the report that was saved, and so
    are its text and its page. Its `patterns` are empty: of the motion it has some states.

    **Arguments**

    - `path`: of the report's folder, or of its `identification.json`.
    - `robot`: that was identified; the one that the file describes if None. Friction terms and
      couplings are taken from the file, unless `robot` has friction terms of single joints or
      couplings of its own.

    **Raises**

    - `ValueError`: the file is no identification of this robot; the message names file and entry.

    >>> import tempfile
    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> report = jc.identify(network, recording, settings=jc.Settings())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = report.save(folder, pictures=False)
    ...     saved = jc.load_report(folder)
    >>> bool(np.all(saved.k == report.k)), saved.settings == report.settings
    (True, True)
    >>> str(saved) == str(report), saved.page(charts=False) == report.page(charts=False)
    (True, True)
    """
    report = read_report(path, Report)
    file = identification_file(path)
    network = saved_network(report.document or {}, report.fit, file, robot)
    object.__setattr__(report, "network", network)
    for section in report.sections:
        for name in section.results:
            try:
                section.result(name, report)
            except AttributeError:  # files do not hold it
                continue
            except ValueError as error:
                raise ValueError(f"{file}: {error}") from None
            except (KeyError, TypeError) as error:
                raise ValueError(f"{file}: {name}: {error!r}") from None
    return report


def read_report(path: str | Path, kind: type[R]) -> R:
    """Return a saved report whose network is derived when it is asked for.

    **Arguments**

    - `path`: of the report's folder, or of its `identification.json`.
    - `kind`: of the report.

    **Raises**

    - `ValueError`: there is no such file, or it holds something else.
    """
    settings, fit, document = read_files(path)
    return kind(None, settings, fit, {}, document=document)
