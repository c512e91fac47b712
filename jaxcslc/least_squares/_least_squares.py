"""`LeastSquares`: the estimator, with all its options (thesis 8.2.3).

Its methods fit patterns, streams, factors and folds with the other modules of this package.
`WeightedEquations` are those that a fit ends with, and `gauss_newton` fits equations that are
linear about the last coefficients.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._environment import require_float64
from .._rank import pseudo_inverse
from ..network import AbstractLinearNetwork
from ..recordings import Patterns
from ._blocks import (
    are_many,
    blocks_of_chunks,
    blocks_of_patterns,
    factors_of_blocks,
    residual_sums_of_blocks,
)
from ._columns import HostColumns, check_joints, columns_of, rows_of, torque_by, traced, untraced
from ._equations import Equations, equations_of, samples_of, unknowns_of
from ._errors import ERRORS, Errors, Rows, correlated_errors, independent_errors
from ._factors import JointFactors, Unknowns
from ._fold_products import FoldProducts
from ._identification import RESULTS, Identification, result_of
from ._losses import LOSSES, Loss, robust_fit, robust_scale, weight
from ._minimum import (
    Fixed,
    FoldFit,
    JointWeights,
    Solution,
    check_nothing_known,
    fold_coefficients,
    fold_fits,
    joint_weights_of,
    minimum,
    minimum_coefficients,
    residual_weights,
)
from ._products import corrected, needs_correction


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """**Raises** `ValueError` for a value that is none of the choices."""
    if value not in choices:
        raise ValueError(f"{name} is {value!r}; expected {' or '.join(map(repr, choices))}")


def check_patterns(network: AbstractLinearNetwork, patterns: Patterns) -> None:
    """**Raises** `ValueError` for patterns of another size, and for others than float64."""
    check_joints(network, patterns)
    if patterns.q.shape[-1] != network.motion_count:
        raise ValueError(
            f"patterns have {patterns.q.shape[-1]} columns of motion, {network.name!r} has"
            f" {network.motion_count}"
        )
    require_float64(patterns.q, patterns.qd, patterns.qdd, patterns.torque)


def checked(fit: Identification, throw: bool) -> Identification:
    """**Raises** `RuntimeError` for results that are failures, if `throw` says so."""
    if not throw:
        return fit
    # Rank deficiency is an answer, not a failure.
    if not traced(fit.result) and result_of(fit) in ("successful", "rank_deficient"):
        return fit
    failed = (fit.result == RESULTS.nonfinite) | (fit.result == RESULTS.no_equations)
    return fit.result.error_if(fit, failed)


@dataclasses.dataclass(frozen=True)
class LeastSquares:
    """The least-squares fit of torque equations: all options, checked once (thesis 8.2.3).

    Torque is linear in the coefficients (Eqn. 4.1-4), so one orthogonal factorisation replaces
    training. Every fit of the library goes through this class.

    **Attributes**

    - `joint_weights`: `"residual"` divides the equations of each joint by their root mean square
      residual, as for joints of different noise; `"equal"`; or n positive numbers. A joint with
      barely more equations than coefficients counts as noisy as is usual.
    - `loss`: `"squared"`, ordinary least squares; or a robust one, minimised by iteratively
      reweighted least squares: `"huber"` bounds the influence of an equation beyond 1.345
      standard deviations, `"bisquare"` ignores equations beyond 4.685. The standard deviation of
      each joint is then estimated by the median absolute error, and `"residual"` divides by that.
      With `cutoff` the filtered equations are reweighted: an outlier should not be longer than
      the filter's memory.
    - `errors`: what standard errors allow for. `"correlated"`: correlation in time, as every
      smoothing makes it, correlation between joints, and strength that varies with the motion; a
      second pass over the patterns. `"independent"`: independent errors of one variance once
      joints are weighted. See `docs/uncertainty.md`.
    - `cutoff`: filter regressor and torque alike by a zero-phase low pass of this frequency [Hz]
      and decimate ('parallel filter', see `jaxcslc.recordings.parallel_filter`), or None. Needs a
      uniform sampling interval, and runs on the host: not under `jit`.
    - `rcond`: singular values below this part of the largest count as zero; by default what
      rounding alone explains.

    **Raises**

    - `ValueError`: an option that is none of these.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> jc.LeastSquares().fit(network, patterns).k.round(6).tolist()
    [0.5, 0.3, -0.1, 0.2, 0.05]
    """

    joint_weights: JointWeights = "residual"
    loss: Loss = "squared"
    errors: Errors = "correlated"
    cutoff: float | None = None
    rcond: float | None = None

    def __post_init__(self) -> None:
        if isinstance(self.joint_weights, str):
            check_choice("joint_weights", self.joint_weights, ("equal", "residual"))
        else:
            # As a tuple, so that solvers can be compared and are constants of compiled functions.
            weights = np.asarray(self.joint_weights, float)
            if weights.ndim != 1 or not np.all((weights > 0.0) & (weights < np.inf)):
                raise ValueError(
                    f"joint_weights: expected positive numbers, one a joint, got {weights.tolist()}"
                )
            object.__setattr__(self, "joint_weights", tuple(weights.tolist()))
        check_choice("loss", self.loss, LOSSES)
        check_choice("errors", self.errors, ERRORS)
        if self.cutoff is not None and not 0.0 < self.cutoff < np.inf:
            raise ValueError(f"cutoff: expected more than 0 Hz, or None, got {self.cutoff}")
        if self.rcond is not None and not 0.0 <= self.rcond < 1.0:
            raise ValueError(f"rcond: expected at least 0 and below 1, or None, got {self.rcond}")

    def fit(
        self,
        network: AbstractLinearNetwork,
        patterns: Patterns,
        fixed: Fixed | None = None,
        throw: bool = True,
    ) -> Identification:
        """Fit the coefficients that minimise the loss of the torque error over the masked patterns.

        **Arguments**

        - `network`: n joints, p coefficients.
        - `patterns`: motion and torque (samples, n); pairs outside of the mask are excluded.
        - `fixed`: coefficients that keep their values; if None, all are fitted except those that
          are numbers in the network (`network.known_values`).
        - `throw`: raise on NaN and on too few equations instead of returning the result code. A
          rank-deficient fit never raises: it returns the solution of least norm and names what is
          missing.

        **Returns** an `Identification`. Without `cutoff` and with `throw=False` the function can
        be jitted and vmapped over recordings.

        **Raises**

        - `ValueError`: if patterns and network differ in joints, or are not in float64.
        - `RuntimeError`: with `throw`, if patterns are not finite or too few.
        """
        fixed = fixed or Fixed.from_known(network)
        return checked(self._fit_patterns(network, patterns, fixed), throw)

    def fit_stream(
        self,
        network: AbstractLinearNetwork,
        chunks: Iterable[Patterns],
        throw: bool = True,
        *,
        workers: int | None = None,
    ) -> Identification:
        """Fit patterns that arrive in pieces, in constant memory; the fit is that of `fit`.

        Every piece is factorised and joined to the triangles of those before (an orthogonal
        factorisation, never the normal equations). A stream passes once, so neither robust losses
        nor correlated errors nor a cut-off are possible.

        **Arguments**

        - `chunks`: patterns in pieces of any size, for instance from
          `jaxcslc.recordings.iterate_recording`.
        - `workers`: how many pieces to factorise at a time; one a core by default. The result does
          not depend on which worker took which piece beyond rounding.
        - the others: as of `fit`.

        **Raises** as `fit`; and `ValueError` if there are no patterns, or for options that need
        a second pass.

        >>> import jaxcslc as jc
        >>> network = jc.derive(jc.examples.turntable())
        >>> patterns = jc.examples.swing(network, [0.5, 0.2, 0.05])
        >>> pieces = (patterns.between(start, start + 5.0) for start in (0.0, 5.0))
        >>> fit = jc.LeastSquares(errors="independent").fit_stream(network, pieces)
        >>> fit.k.round(6).tolist()
        [0.5, 0.2, 0.05]
        """
        if self.loss != "squared" or self.errors != "independent" or self.cutoff is not None:
            raise ValueError(
                "a stream passes once: expected loss 'squared', errors 'independent' and no"
                f" cutoff, got {self}"
            )
        factors = factors_of_blocks(network, blocks_of_chunks(network, chunks, workers))
        return self.fit_factors(network, factors, throw)

    def fit_factors(
        self,
        network: AbstractLinearNetwork,
        factors: JointFactors,
        throw: bool = True,
    ) -> Identification:
        """Fit factorised patterns by ordinary least squares, with errors for independent noise."""
        unknowns, fixed = Unknowns.of(network), Fixed.from_known(network)
        return checked(self._fit_rows(unknowns, factors, None, fixed), throw)

    def fit_equations(
        self, equations: Equations, samples: int, fixed: Fixed | None = None, throw: bool = True
    ) -> Identification:
        """Fit equations of recordings with these numbers of samples, like `fit`; on the host."""
        rows = Rows.from_equations(equations, samples) if self._passes_twice else None
        return checked(self._fit_rows(equations.unknowns, equations.factors(), rows, fixed), throw)

    def coefficients(self, equations: Equations) -> Float[np.ndarray, " coefficients"]:
        """Return the coefficients of `fit_equations` alone, for the squared loss.

        NaN where equations are not finite.
        """
        unknowns, factors = equations.unknowns, equations.factors()
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = joint_weights_of(unknowns, factors, self.joint_weights, self.rcond)
            return minimum_coefficients(unknowns, factors, weights, self.rcond)

    def equations(self, network: AbstractLinearNetwork, patterns: Patterns) -> Equations:
        """Return the equations that `fit` solves, one for each pair of the mask, or those that the
        parallel filter makes of them; on the host.
        """
        check_patterns(network, patterns)
        check_nothing_known(network, "equations")
        return equations_of(network, patterns, self.cutoff)

    def fit_folds(
        self,
        network: AbstractLinearNetwork,
        patterns: Patterns,
        fold: Int[np.ndarray, " samples"],
        columns: HostColumns | None = None,
        unknowns: Unknowns | None = None,
    ) -> Float[np.ndarray, "folds coefficients"]:
        """Fit coefficients to all folds except one, for each held-out fold; on the host.

        - `fold`, `columns`, `unknowns`: as of `held_out_errors`.
        """
        check_nothing_known(network, "folds")
        equations = equations_of(network, patterns, self.cutoff, columns, unknowns)
        if self.loss == "squared":
            k = FoldProducts.of(equations, fold).coefficients(self.joint_weights, self.rcond)
            if k is not None:
                return k
            factors = equations.factors_of_folds(fold, int(np.max(fold)) + 1)
            return fold_coefficients(equations.unknowns, factors, self.joint_weights, self.rcond)
        return np.stack([np.asarray(fit.k) for fit in self._iterated_folds(equations, fold)])

    def fits_without_folds(
        self,
        network: AbstractLinearNetwork,
        patterns: Patterns,
        fold: Int[np.ndarray, " samples"],
        columns: HostColumns | None = None,
    ) -> tuple[FoldFit, ...]:
        """Return the fits of `fit_folds` with covariances for independent errors; on the host.

        - `fold`, `columns`: as of `held_out_errors`.
        """
        check_nothing_known(network, "folds")
        equations = equations_of(network, patterns, self.cutoff, columns)
        if self.loss == "squared":
            factors = equations.factors_of_folds(fold, int(np.max(fold)) + 1)
            return fold_fits(equations.unknowns, factors, self.joint_weights, self.rcond)
        fits = self._iterated_folds(equations, fold)
        return tuple(
            FoldFit(*map(np.asarray, (fit.k, fit.covariance, fit.undetermined))) for fit in fits
        )

    def held_out_errors(
        self,
        network: AbstractLinearNetwork,
        patterns: Patterns,
        fold: Int[np.ndarray, " samples"],
        columns: HostColumns | None = None,
        unknowns: Unknowns | None = None,
    ) -> Float[np.ndarray, "samples joints"]:
        """Torque error of each sample under the coefficients fitted without its fold.

        - `fold`: the fold of each sample, from 0.
        - `columns`: of the regressor of the patterns' motion, for each joint those of its support
          (support, samples), if they are known already.
        - `unknowns`: of these columns (`unknowns_of`), if they are known already.
        """
        if columns is None:
            check_patterns(network, patterns)
            columns = columns_of(network, patterns)
        k = self.fit_folds(network, patterns, fold, columns, unknowns)
        errors = np.array(patterns.torque, float)
        for number, coefficients in enumerate(k):
            rows = samples_of(fold, number)
            part = tuple(joint_columns[:, rows] for joint_columns in columns)
            errors[rows] -= torque_by(network.support, part, coefficients)
        return errors

    def _iterated_folds(
        self, equations: Equations, fold: Int[np.ndarray, " samples"]
    ) -> Iterator[Identification]:
        """Fits of a robust loss without each fold, which are iterative: one after the other."""
        solver = dataclasses.replace(self, errors="independent")
        for number in range(int(np.max(fold)) + 1):
            yield solver.fit_equations(equations.selected(fold != number), len(fold), throw=False)

    @property
    def description(self) -> str:
        """The options that matter, in words."""
        if isinstance(self.joint_weights, str):
            weights = "equally" if self.joint_weights == "equal" else "by residual"
        else:
            weights = f"by {', '.join(f'{float(weight):g}' for weight in self.joint_weights)}"
        parts = [
            "" if self.cutoff is None else f"low-pass at {self.cutoff:g} Hz",
            f"joints weighted {weights}",
            "" if self.loss == "squared" else f"loss of {self.loss!r}",
        ]
        return ", ".join(part for part in parts if part)

    @property
    def _passes_twice(self) -> bool:
        """The ordinary fit needs no more of its equations than their factors."""
        return self.loss != "squared" or self.errors != "independent"

    def _fit_patterns(
        self, network: AbstractLinearNetwork, patterns: Patterns, fixed: Fixed | None
    ) -> Identification:
        check_patterns(network, patterns)
        unknowns = Unknowns.of(network)
        if self.cutoff is None and traced((network, patterns, fixed)):
            rows = Rows.from_patterns(network, jax.tree.map(jnp.asarray, patterns))
            factors = rows.factors(jnp.ones(rows.counts.shape))
            return self._fit_rows(unknowns, factors, rows if self._passes_twice else None, fixed)
        if self.cutoff is None and are_many(patterns):
            if isinstance(patterns.q, np.ndarray):
                # Of many patterns, those in which columns of rounding are looked for.
                some = rows_of(patterns, slice(None, None, max(len(patterns.q) // (1 << 12), 1)))
                unknowns = unknowns_of(network, some, columns_of(network, some))
            factors = factors_of_blocks(network, blocks_of_patterns(network, patterns))
            rows = Rows.from_patterns(network, patterns) if self._passes_twice else None
            sums = lambda k: residual_sums_of_blocks(
                network, blocks_of_patterns(network, patterns), k
            )
            return self._fit_rows(unknowns, factors, rows, fixed, sums)
        equations = equations_of(network, patterns, self.cutoff)
        return self.fit_equations(equations, len(patterns.q), fixed, throw=False)

    def _fit_rows(
        self,
        unknowns: Unknowns,
        factors: JointFactors,
        rows: Rows | None,
        fixed: Fixed | None,
        sums: Callable[[Any], Any] | None = None,
    ) -> Identification:
        """Fit factorised equations.

        - `rows`: the equations themselves, for a second pass; None for ordinary least squares with
          errors for independent noise.
        - `sums`: `residual_sums` as a function of coefficients, of patterns that can be read again.
        """
        factors, fixed = untraced((factors, fixed))
        if traced((factors, fixed)):
            factors = jax.tree.map(jnp.asarray, factors)
        # NaN is the answer where there is none, as JAX has it.
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = joint_weights_of(unknowns, factors, self.joint_weights, self.rcond, fixed)
            solution = minimum(unknowns, factors, weights, self.rcond, fixed)
            if sums is not None and needs_correction(unknowns, factors, solution, weights):
                solution = corrected(unknowns, solution, weights, sums(solution.k))
            if rows is None:
                return independent_errors(unknowns, factors, solution, fixed)
            if self.loss == "squared":
                residual = rows.residuals(solution.k)
            else:
                by_residual = isinstance(self.joint_weights, str)
                solution, weights, residual = robust_fit(
                    rows,
                    factors,
                    solution,
                    weights,
                    by_residual=by_residual and self.joint_weights == "residual",
                    loss=self.loss,
                    rcond=self.rcond,
                    fixed=fixed,
                )
            if self.errors == "independent":
                return independent_errors(unknowns, factors, solution, fixed)
            return correlated_errors(rows, factors, solution, weights, residual, fixed)


@dataclasses.dataclass(frozen=True)
class WeightedEquations:
    """The equations of a fit with the weights that it ended with: what errors of it are linear in.

    **Attributes**

    - `equations`: as of `LeastSquares.equations`.
    - `weights`: of joints, (n,).
    - `roots`: for each joint, the roots of its equations' weights under a robust loss.
    - `rcond`: of `LeastSquares`.
    """

    equations: Equations
    weights: Float[np.ndarray, " joints"]
    roots: tuple[Float[np.ndarray, " _"], ...]
    rcond: float | None

    @classmethod
    def of(
        cls, equations: Equations, k: Float[np.ndarray, " unknowns"], solver: LeastSquares
    ) -> "WeightedEquations":
        """Weight equations as in their fit, which ended with `k`."""
        errors = equations.errors(k)
        roots = tuple(_robust_roots(error, solver.loss) for error in errors)
        counts = np.array([float(len(error)) for error in errors])
        if solver.joint_weights == "residual":
            squares = [np.sum((r * e) ** 2) for r, e in zip(roots, errors, strict=True)]
            weights = residual_weights(
                np.sqrt(squares / np.maximum(counts, 1.0)),
                counts,
                equations.torque_scale(),
                equations.unknowns.joint_sizes,
            )
        elif isinstance(solver.joint_weights, str):
            weights = np.ones(len(errors))
        else:
            weights = np.asarray(solver.joint_weights, float)
        return cls(equations, np.asarray(weights), roots, solver.rcond)

    def solution(self, equations: Equations) -> Solution:
        """Return the minimum of other equations of the same pairs, with the same weights."""
        return self.minimum(equations.unknowns, equations.times(self.roots).factors())

    def factors_of_folds(
        self, equations: Equations, fold: Int[np.ndarray, " samples"]
    ) -> JointFactors:
        """Return the factors of other equations of the same pairs, each fold by itself.

        - `fold`: the fold of each sample, from 0.
        """
        return equations.times(self.roots).factors_of_folds(fold, int(fold[-1]) + 1)

    def minimum(self, unknowns: Unknowns, factors: JointFactors) -> Solution:
        """Return the minimum of factorised equations, joints weighted as here."""
        return minimum(unknowns, factors, self.weights, self.rcond)

    def shifts(
        self, torques: Sequence[Float[np.ndarray, "_ changes"]]
    ) -> Float[np.ndarray, "unknowns changes"]:
        """Return the changes of the unknowns when changes are added to the torques.

        - `torques`: for each joint (equations, changes).
        """
        last = max((int(sample[-1]) for sample in self.equations.sample if sample.size), default=0)
        return self.shifts_of_stretches(torques, np.array([0, last + 1]))[0]

    def shifts_of_stretches(
        self, torques: Sequence[Float[np.ndarray, "_ changes"]], edges: Int[np.ndarray, " edges"]
    ) -> Float[np.ndarray, "stretches unknowns changes"]:
        """Return the part of `shifts` due to the equations in each stretch of the recording.

        - `edges`: samples that stretches begin with, and the one after the last.
        """
        unknowns = self.equations.unknowns
        scores = np.zeros((len(edges) - 1, unknowns.size, torques[0].shape[1]))
        for support, rows, sample, size, root, columns in zip(
            unknowns.support,
            self.equations.rows,
            self.equations.sample,
            self.weights,
            self.roots,
            torques,
            strict=True,
        ):
            weighted = ((size * root) ** 2)[:, None] * rows[:, :-1]
            bounds = pairwise(np.searchsorted(sample, edges))
            for score, (start, stop) in zip(scores, bounds, strict=True):
                score[list(support)] += weighted[start:stop].T @ columns[start:stop]
        return np.asarray(self.solution(self.equations).inverse_gram) @ scores


def changes_of(
    stacked: Float[np.ndarray, "rows columns"], size: int
) -> Float[np.ndarray, "unknowns further"]:
    """Return the changes of the first unknowns per unit of each further unknown that is omitted.

    - `stacked`: the columns of the unknowns, of the further ones, and the torque.
    """
    return pseudo_inverse(stacked[:, :size]) @ stacked[:, size:-1]


def _robust_roots(error: Float[np.ndarray, " equations"], loss: Loss) -> Float[np.ndarray, " _"]:
    """The roots of the weights that a joint's equations have in a fit that leaves these errors."""
    if loss == "squared" or not error.size:
        return np.ones(len(error))
    scale = float(robust_scale(error[:, None], np.ones((len(error), 1)))[0])
    return np.sqrt(weight(loss, error / (scale or 1.0)))


_STEPS = 30  # fits, at most
_PART = 1e-3  # of a standard error: a step that moves no coefficient further is the last
_ROUNDING = 1e-10  # of the largest coefficient: the same, of a fit without noise


def gauss_newton(
    fitted: Callable[[Float[np.ndarray, " coefficients"]], Identification],
    start: Float[np.ndarray, " coefficients"],
) -> Identification:
    """Return the last of the fits that start from each other's coefficients.

    - `fitted`: the fit of the equations that are linear about some coefficients.
    """
    fit = fitted(start)
    for _ in range(_STEPS - 1):
        if settled(fit, start, _PART):
            break
        start = np.asarray(fit.k)
        fit = fitted(start)
    return fit


def settled(fit: Identification, before: Float[np.ndarray, " coefficients"], part: float) -> bool:
    """Return whether no coefficient has moved by this part of its standard error."""
    k = np.asarray(fit.k)
    error = np.where(np.asarray(fit.determined), np.asarray(fit.standard_error), np.inf)
    return bool(np.all(np.abs(k - before) <= part * error + _ROUNDING * np.max(np.abs(k))))
