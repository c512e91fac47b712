"""Settings from a recording to coefficients, their plain data, and `reidentify`.

`reidentify` fits some coefficients and keeps the others (thesis 5.2.4).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from .._plain_data import check_field_types
from ..network import CSLC, AbstractLinearNetwork
from ..recordings import (
    Patterns,
    Preparation,
    Recording,
    Sampling,
    smoothing_document,
    smoothing_from,
    uniform_interval,
)
from ._identification import Identification
from ._least_squares import LeastSquares
from ._minimum import Fixed, Previous


def reidentify(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    previous: Previous,
    *,
    groups: Sequence[str] = ("viscous", "dry"),
    solver: LeastSquares | None = None,
    throw: bool = True,
) -> Identification:
    """Fits some coefficients and keeps the others at their previous values (thesis 5.2.4).

    A change of friction alone, as by cleaning bearings, needs friction alone to be re-identified:
    from a recording far too short for all coefficients, over which a fit of all would spread its
    errors. The torque of the fixed coefficients k_f is taken off the measured torque,

        regressor_free @ k_free = torque - regressor_f @ k_f,

    at the level of factors: only the free columns are solved for.

    **Arguments**

    - `previous`: an `Identification` of the same network, or its (p,) coefficients. Its last
      coefficients may be missing if they are all fitted, as for a payload.
    - `groups`: what to fit, any `Coefficient.group` (`"viscous"`, `"dry"`, `"static"`,
      `"payload"`, ...) or names of single coefficients.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None. Joint weights of
      `"residual"` also weigh errors of the fixed coefficients, which are part of the residual.
    - `throw`: as of `LeastSquares.fit`.

    **Returns** an `Identification` of all p coefficients. The fixed ones are as before, standard
    errors included. Errors of the others are those of this recording's noise and, if `previous` is
    an `Identification`, what errors of the fixed coefficients do to them; the two are independent
    if the recordings are. Vectors count as exact. `rank`, `condition` and `undetermined` are of
    the fitted part; `degrees_of_freedom` is the smaller of the two fits'. Where the patterns leave
    a choice, the change from `previous` is the least one, as for a joint that stands still. A
    combination that `previous` left undetermined keeps the value that it had. Jit and vmap as for
    `LeastSquares.fit`.

    **Raises**

    - `ValueError`: for groups that are none and for another network's coefficients; or as
      `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> before, cleaned = np.array([[0.5, 0.3, -0.1, 0.2, 0.05], [0.5, 0.3, -0.1, 0.1, 0.04]])
    >>> patterns = jc.examples.swing(network, cleaned, samples=30)
    >>> jc.reidentify(network, patterns, before).k.round(6).tolist()
    [0.5, 0.3, -0.1, 0.1, 0.04]
    """
    fixed = Fixed.except_for(network, previous, groups)
    return (solver or LeastSquares()).fit(network, patterns, fixed, throw)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings from a recording to its coefficients: a preparation and a solver.

    The defaults are those of `Preparation` and `LeastSquares`, and suit a first look;
    `choose_settings` finds better ones by cross-validation within a recording.

    **Attributes**

    - `preparation`: smoothing, torque alignment and masks, from a recording to patterns.
    - `solver`: weights, loss, errors and parallel filter, from patterns to coefficients.
    - `chosen_on`: how the recording was sampled that the settings were chosen on, for `check`;
      None for settings made by hand.

    >>> import numpy as np, jaxcslc as jc
    >>> print(jc.Settings(solver=jc.LeastSquares(cutoff=15.0)))
    averaged splines of 9 samples, velocities from positions, torque of 'sample', masked below \
3 % of top speed, low-pass at 15 Hz, joints weighted by residual
    >>> time = np.arange(400) * 0.01
    >>> recording = jc.Recording(time, np.sin(time)[:, None], np.cos(time)[:, None])
    >>> jc.Settings(jc.Preparation(trim=10)).patterns(recording).samples
    380
    """

    preparation: Preparation = dataclasses.field(default_factory=Preparation)
    solver: LeastSquares = dataclasses.field(default_factory=LeastSquares)
    chosen_on: Sampling | None = dataclasses.field(default=None, compare=False)

    def with_options(self, **options: Any) -> "Settings":
        """Return the settings with some options of their preparation or solver changed.

        **Arguments**

        - `options`: by the names that `Preparation` and `LeastSquares` give them.

        **Returns**

        The new settings.

        **Raises**

        - `ValueError`: an option that neither has, or a wrong value.

        >>> import jaxcslc as jc
        >>> settings = jc.Settings().with_options(torque_alignment="mean", cutoff=15.0)
        >>> settings.preparation.torque_alignment, settings.solver.cutoff
        ('mean', 15.0)
        """
        of_preparation, of_solver = _names(Preparation), _names(LeastSquares)
        if unknown := sorted(options.keys() - of_preparation - of_solver):
            raise ValueError(
                f"settings: unknown entry {unknown[0]!r}; expected some of"
                f" {', '.join(sorted(of_preparation | of_solver))}"
            )
        return dataclasses.replace(
            self,
            preparation=dataclasses.replace(
                self.preparation,
                **{name: options[name] for name in options.keys() & of_preparation},
            ),
            solver=dataclasses.replace(
                self.solver, **{name: options[name] for name in options.keys() & of_solver}
            ),
        )

    def for_network(self, network: CSLC) -> "Settings":
        """Return the settings with all values that depend on the network's terms filled in.

        **Arguments**

        - `network`: that patterns will be fitted by.

        **Returns**

        The settings; joints with a term of static friction keep their slow pairs, unless
        thresholds were set: see `Preparation.with_static_friction`.
        """
        return dataclasses.replace(
            self, preparation=self.preparation.with_static_friction(static_friction_joints(network))
        )

    def patterns(self, recording: Recording) -> Patterns:
        """Return the patterns that a fit gets from a recording under these settings.

        **Raises**

        - `ValueError`: as `Preparation.patterns`.
        """
        return self.preparation.patterns(recording)

    def fit(self, network: AbstractLinearNetwork, patterns: Patterns) -> Identification:
        """Fit by the direct solve under these settings.

        **Raises**

        - `ValueError`, `RuntimeError`: as `LeastSquares.fit`.
        """
        return self.solver.fit(network, patterns)

    def reidentify(
        self,
        network: AbstractLinearNetwork,
        patterns: Patterns,
        previous: Previous,
        groups: Sequence[str],
    ) -> Identification:
        """Fit a part of the coefficients under these settings.

        **Raises**

        - `ValueError`, `RuntimeError`: as `reidentify`.
        """
        return reidentify(network, patterns, previous, groups=groups, solver=self.solver)

    def check(self, recording: Recording) -> tuple[str, ...]:
        """List the reasons against applying these settings to a recording.

        A coarser encoder, another sampling rate or irregular time stamps call for another
        smoothing: `Candidates.keeping` and `choose_settings` choose one for the recording.

        **Arguments**

        - `recording`: such as a validation recording, of as many joints as that which the
          settings were chosen on.

        **Returns**

        Sentences with numbers, without the name of the recording; empty if nothing differs.

        >>> import dataclasses, numpy as np, jaxcslc as jc
        >>> time = np.arange(1000) * 0.002
        >>> position = 1e-4 * np.round(np.sin(time)[:, None] / 1e-4)
        >>> fine = jc.Recording(time, position, position)
        >>> settings = dataclasses.replace(jc.Settings(), chosen_on=jc.recordings.Sampling.of(fine))
        >>> settings.check(fine)
        ()
        >>> settings.check(jc.Recording(time, 5e-4 * np.round(position / 5e-4), position))
        ('joint 1: encoder steps of 0.0005, 5 times the 0.0001 that the settings were chosen for',)
        """
        sentences = self.preparation.check(recording, self.chosen_on)
        if self.solver.cutoff is None:
            return sentences
        try:
            interval = uniform_interval(recording.time)
        except ValueError as error:
            return (*sentences, f"the filter at {self.solver.cutoff:g} Hz cannot be used: {error}")
        if self.solver.cutoff >= 0.5 / interval:
            return (
                *sentences,
                f"the filter at {self.solver.cutoff:g} Hz cannot be used: expected less than half"
                f" the sampling rate of {1.0 / interval:g} Hz",
            )
        return sentences

    def __repr__(self) -> str:
        return f"Settings({self})"

    def __str__(self) -> str:
        return f"{self.preparation.description}, {self.solver.description}"


def static_friction_joints(network: CSLC) -> tuple[bool, ...]:
    """True for each joint whose network has a term of static friction."""
    return tuple("static" in kinds for kinds in network.friction_per_joint)


def settings_document(settings: Settings) -> dict[str, Any]:
    """Settings as plain data, to be written and read again.

    **Arguments**

    - `settings`: with a smoothing of a registered class.

    **Returns**

    The entries `"preparation"`, `"solver"` and, if known, `"chosen_on"`.

    **Raises**

    - `ValueError`: a smoothing that has no name in a file.

    >>> import jaxcslc as jc
    >>> settings = jc.Settings(jc.Preparation(jc.Butterworth(20.0)), jc.LeastSquares(cutoff=15.0))
    >>> settings_from(settings_document(settings)) == settings
    True
    """
    preparation = _fields(settings.preparation)
    preparation["smoothing"] = smoothing_document(settings.preparation.smoothing)
    document = {"preparation": preparation, "solver": _fields(settings.solver)}
    if settings.chosen_on is not None:
        document["chosen_on"] = _fields(settings.chosen_on)
    return document


def settings_from(document: Mapping[str, Any]) -> Settings:
    """Settings from what `settings_document` made, read from JSON or TOML.

    **Arguments**

    - `document`: a mapping with entries `"preparation"` and `"solver"`, or with their entries
      side by side, as in files of earlier versions and in files written by hand.

    **Returns**

    The settings.

    **Raises**

    - `ValueError`: naming the entry that is unknown or wrong.

    >>> settings = settings_from(
    ...     {"cutoff": 8.0, "smoothing": {"method": "butterworth", "cutoff": 20.0}}
    ... )
    >>> settings.preparation.smoothing.cutoff, settings.solver.cutoff
    (20.0, 8.0)
    """
    entries = dict(document)
    chosen_on = entries.pop("chosen_on", None)
    options: dict[str, Any] = {}
    for part in ("preparation", "solver"):
        values = entries.pop(part, {})
        if not isinstance(values, Mapping):
            raise ValueError(f"settings, {part}: expected entries, got {values!r}")
        options.update(values)
    options.update(entries)
    options = {
        name: tuple(value) if isinstance(value, list) else value for name, value in options.items()
    }
    if "smoothing" in options:
        options["smoothing"] = smoothing_from(options["smoothing"])
    for kind in (Preparation, LeastSquares):
        check_field_types(kind, options, "settings")
    try:
        return dataclasses.replace(
            Settings().with_options(**options),
            chosen_on=None if chosen_on is None else _sampling(chosen_on),
        )
    except TypeError as error:
        raise ValueError(f"settings: {error}") from None


def _sampling(document: Any) -> Sampling:
    if not isinstance(document, Mapping):
        raise ValueError(f"settings, chosen_on: expected entries, got {document!r}")
    entries: dict[str, Any] = {
        str(name): tuple(value) if isinstance(value, list) else value
        for name, value in document.items()
    }
    check_field_types(Sampling, entries, "settings, chosen_on")
    return Sampling(**entries)


def _names(kind: type) -> set[str]:
    return {field.name for field in dataclasses.fields(kind)}


def _fields(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
