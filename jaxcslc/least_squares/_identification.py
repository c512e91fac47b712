"""Result of a fit: `Identification`, its outcome, and what patterns do not determine."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from .._display import html_table
from .._environment import array_namespace, as_jax, require
from .._plain_data import plain
from .._scratch import unfinished
from .._text_table import counted
from ._columns import untraced


# Entries of the echelon form below this part of a row's largest are rounding.
_NEGLIGIBLE = 1e-6


def describe(
    null_space: Float[np.ndarray, "rows coefficients"], names: Sequence[str]
) -> tuple[str, ...]:
    """Describe a null space in terms of named coefficients, one sentence per group.

    Coefficients that share a null vector form a group. Of a group of m coefficients with d null
    vectors, m - d combinations are still determined; the reduced echelon form of what is
    orthogonal to the null vectors names them.

    >>> import numpy as np
    >>> describe(np.array([[1.0, -2.0, 0.0], [0.0, 0.0, 0.0]]), ("a", "b", "c"))
    ('a, b: only the combination a + 0.5*b is determined',)
    """
    rows = null_space[np.linalg.norm(null_space, axis=1) > 0]
    if not rows.size:
        return ()
    echelon = _reduced_echelon(rows / np.linalg.norm(rows, axis=1, keepdims=True))
    involved = np.abs(echelon) > _NEGLIGIBLE
    groups: list[set[int]] = []
    for row in involved:
        group = set(np.flatnonzero(row).tolist())
        for other in [other for other in groups if other & group]:
            groups.remove(other)
            group |= other
        groups.append(group)
    return tuple(_sentence(sorted(group), echelon, names) for group in sorted(groups, key=min))


def _sentence(group: list[int], echelon: np.ndarray, names: Sequence[str]) -> str:
    listed = ", ".join(names[i] for i in group)
    rows = echelon[:, group]
    rows = rows[np.linalg.norm(rows, axis=1) > _NEGLIGIBLE]
    determined = scipy.linalg.null_space(rows).T
    if not determined.size:
        return f"{listed}: nothing in the patterns depends on {'it' if len(group) == 1 else 'them'}"
    combinations = [
        _combination(row, [names[i] for i in group]) for row in _reduced_echelon(determined)
    ]
    several = len(combinations) > 1
    return (
        f"{listed}: only the combination{'s' if several else ''} {', '.join(combinations)}"
        f" {'are' if several else 'is'} determined"
    )


def _combination(row: np.ndarray, names: Sequence[str]) -> str:
    text = ""
    for value, name in zip(row, names, strict=True):
        if abs(value) > _NEGLIGIBLE:
            number = "" if np.isclose(abs(value), 1.0) else f"{abs(value):.6g}*"
            sign = "-" if value < 0 else "+"
            text += (
                f" {sign} {number}{name}" if text else f"{'-' if value < 0 else ''}{number}{name}"
            )
    return text


def _reduced_echelon(rows: np.ndarray) -> np.ndarray:
    """Gauss-Jordan with the largest pivot of each column; rounding is set to zero."""
    matrix = rows.copy()
    lead = 0
    for column in range(matrix.shape[1]):
        if lead == len(matrix):
            break
        pivot = lead + int(np.argmax(np.abs(matrix[lead:, column])))
        if abs(matrix[pivot, column]) <= _NEGLIGIBLE * max(np.abs(matrix).max(), 1e-300):
            matrix[lead:, column] = 0.0
            continue
        matrix[[lead, pivot]] = matrix[[pivot, lead]]
        matrix[lead] /= matrix[lead, column]
        for other in range(len(matrix)):
            if other != lead:
                matrix[other] -= matrix[other, column] * matrix[lead]
        lead += 1
    return matrix[:lead]


# Beyond this condition of a regressor with columns of unit length, the least determined combination
# of coefficients follows the eighth digit of the regressor, which no measured motion has.
MEANINGLESS_CONDITION = 1e8
_VERSION = 1
_RESULTS = ("successful", "rank_deficient", "no_equations", "nonfinite")
# Entries and their shapes, in coefficients (p) and joints (n).
_ARRAYS = {
    "k": "p",
    "standard_error": "p",
    "covariance": "pp",
    "independent_covariance": "pp",
    "torque_error": "n",
    "equations": "n",
    "effective_equations": "n",
    "degrees_of_freedom": "",
    "rank": "",
    "condition": "",
    "undetermined": "pp",
    "determined": "p",
}
_TYPES = {"rank": int, "determined": bool}
# What may be infinite, and is written as null.
_OPEN = ("standard_error",)


class RESULTS(eqx.Enumeration):
    """Outcome of a fit. The members are the messages."""

    successful = ""
    rank_deficient = (
        "The patterns do not determine every coefficient: `unidentifiable` names the others."
        " Record motion that excites them, fix them at known values, or derive with"
        " lengths='numeric'."
    )
    no_equations = (
        "Fewer equations than coefficients are left after masking. Lower the velocity thresholds"
        " or record more motion."
    )
    nonfinite = "The patterns hold NaN or infinite numbers."


class Identification(eqx.Module):
    """Coefficients found by a fit, and how far the patterns determine them.

    **Attributes**

    - `k`: (p,) coefficients, in the order of `network.coefficients`, in their units. Where the
      patterns leave a choice, the one of least norm after scaling every column to unit length.
    - `standard_error`: (p,) standard deviation of each; infinite where the patterns do not
      determine it, and of all where there are no more equations than the rank.
    - `covariance`: (p, p); entries of undetermined coefficients are those of the chosen solution.
      For correlated errors its rank is at most `degrees_of_freedom`: read variances and
      correlations off it, do not invert it.
    - `independent_covariance`: (p, p), what `covariance` would be for independent errors. Its
      inverse measures changes of the coefficients by the squared torque that they cause.
    - `torque_error`: (n,) root mean square residual of each joint over the pairs that counted
      [N m or N].
    - `equations`: (n,) how many equations each joint took part with.
    - `effective_equations`: (n,) how many independent ones they are worth; the same number unless
      correlation was allowed for.
    - `degrees_of_freedom`: of Student's t, for the standard errors.
    - `rank`: of the regressor.
    - `condition`: ratio of the largest to the smallest singular value that counts, columns
      scaled to unit length.
    - `undetermined`: (p, p), its rows span the combinations of coefficients that can be added to
      `k` without changing any torque; rows beyond p - rank are zero.
    - `determined`: (p,) whether the patterns determine the coefficient by itself.
    - `result`: a member of `RESULTS`.
    - `names`: of the coefficients.
    - `errors`: `"independent"` or `"correlated"`, what was allowed for; see `LeastSquares`. Or
      `"simulated"`: errors that simulated measurement noise made; see `jaxcslc.systems`.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> network.names  # inertia, viscous and Coulomb friction of a joint with an upright axis
    ('kB1', 'kv1', 'kd1')
    >>> patterns = jc.examples.swing(network, [0.5, 0.2, 0.05], torque_noise=0.1)
    >>> fit = jc.LeastSquares(errors="independent").fit(network, patterns)
    >>> low, high = fit.confidence_interval(0.95)[0]
    >>> bool(low < 0.5 < high)
    True
    >>> fit.to_pandas().columns.tolist()
    ['value', 'standard_error', 'low', 'high', 'determined']
    """

    k: Float[Array, " coefficients"]
    standard_error: Float[Array, " coefficients"]
    covariance: Float[Array, "coefficients coefficients"]
    independent_covariance: Float[Array, "coefficients coefficients"]
    torque_error: Float[Array, " joints"]
    equations: Float[Array, " joints"]
    effective_equations: Float[Array, " joints"]
    degrees_of_freedom: Float[Array, ""]
    rank: Int[Array, ""]
    condition: Float[Array, ""]
    undetermined: Float[Array, "coefficients coefficients"]
    determined: Bool[Array, " coefficients"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    errors: str = eqx.field(static=True)

    @property
    def meaningful(self) -> Bool[Array | np.ndarray, ""] | np.bool:
        """True if the condition number allows conclusions about single coefficients.

        Above `MEANINGLESS_CONDITION`, the least determined combination consists of errors of the
        regressor itself, for which no standard error allows.
        """
        return untraced(self.condition) <= MEANINGLESS_CONDITION

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """Coefficients that the patterns do not determine, in words, and determined combinations.

        One entry for every group of coefficients that the patterns leave undetermined, with the
        combinations of them that are determined. Not available under `jit`.
        """
        return describe(np.asarray(self.undetermined), self.names)

    @property
    def correlation(self) -> Float[Array | np.ndarray, "coefficients coefficients"]:
        """Correlation of the coefficients' errors, (p, p), from -1 to 1.

        It is 0 between a coefficient whose error is zero and others.
        """
        covariance = untraced(self.covariance)
        xp = array_namespace(covariance)
        deviation = xp.sqrt(xp.diag(covariance))
        positive = deviation > 0.0
        scale = xp.where(positive, deviation, 1.0)
        correlation = covariance / scale[:, None] / scale[None, :]
        return xp.where(np.eye(len(scale), dtype=bool), 1.0, xp.clip(correlation, -1.0, 1.0))

    def confidence_interval(self, level: float = 0.95) -> Float[np.ndarray, "coefficients 2"]:
        """Lower and upper end of each coefficient's interval, (p, 2), from Student's t.

        Infinite where the patterns do not determine a coefficient. Not available under `jit`.

        **Arguments**

        - `level`: how many of such intervals should hold the truth, as a part of all of them.

        **Raises**

        - `ValueError`: a level that is not between 0 and 1.
        """
        return self.interval_of(self.k, self.standard_error, level)

    def interval_of(self, value: Any, error: Any, level: float) -> Float[np.ndarray, "values 2"]:
        """Return intervals of values whose standard errors have this fit's degrees of freedom.

        **Raises** `ValueError` as `confidence_interval`.
        """
        if not 0.0 < level < 1.0:
            raise ValueError(f"level is {level}; expected more than 0 and less than 1")
        quantile = float(scipy.special.stdtrit(float(self.degrees_of_freedom), 0.5 + 0.5 * level))
        half = quantile * np.asarray(error)
        return np.stack([np.asarray(value) - half, np.asarray(value) + half], axis=-1)

    def with_k(self, k: Float[Array | np.ndarray, " coefficients"]) -> "Identification":
        """Return the fit with other coefficients; errors and residuals stay as they are."""
        return eqx.tree_at(lambda fit: fit.k, self, jnp.asarray(k))

    def to_pandas(self, level: float = 0.95) -> Any:
        """Return a `pandas.DataFrame`, one row per coefficient: value, standard error, interval.

        **Arguments**

        - `level`: of the interval, as for `confidence_interval`.
        """
        pandas = require("pandas", "tables")

        interval = self.confidence_interval(level)
        return pandas.DataFrame(
            {
                "value": np.asarray(self.k),
                "standard_error": np.asarray(self.standard_error),
                "low": interval[:, 0],
                "high": interval[:, 1],
                "determined": np.asarray(self.determined),
            },
            index=pandas.Index(self.names, name="coefficient"),
        )

    def document(self) -> dict[str, Any]:
        """Return all results as plain data; numbers that JSON lacks are None."""
        return {
            "version": _VERSION,
            "names": list(self.names),
            "errors": self.errors,
            "result": result_of(self),
            **{name: plain(getattr(self, name)) for name in _ARRAYS},
        }

    def save(self, path: Path | str) -> None:
        """Writes it as JSON, numbers in full precision.

        **Raises**

        - `OSError`: the file cannot be written.
        """
        text = json.dumps(self.document(), indent=1, allow_nan=False) + "\n"
        with unfinished(Path(path)) as file:
            file.write_text(text, encoding="utf-8")

    @classmethod
    def load(cls, path: Path | str) -> "Identification":
        """Reads what `save` wrote, or the `identification.json` of `jaxcslc identify`.

        **Raises**

        - `OSError`: there is no such file.
        - `ValueError`: it holds something else; the message names the entry.
        """
        try:
            document = json.loads(Path(path).read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ValueError(f"{path}: not valid JSON: {error}") from None
        if not isinstance(document, dict):
            raise ValueError(f"{path}: expected an identification as a JSON object")
        return cls.from_document(document, str(path))

    @classmethod
    def from_document(cls, document: Mapping[str, Any], where: str) -> "Identification":
        """Read an identification from the result of `document`; errors say `where` it was read.

        **Raises**

        - `ValueError`: it is something else; the message names the entry.
        """
        for name in ("version", "names", "errors", "result", *_ARRAYS):
            if name not in document:
                raise ValueError(f"{where}: no entry {name!r}; expected a saved identification")
        if document["version"] != _VERSION:
            raise ValueError(f"{where}: version is {document['version']!r}; expected {_VERSION}")
        names = document["names"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"{where}: names: expected a list of names")
        if document["errors"] not in ("independent", "correlated", "simulated"):
            raise ValueError(
                f"{where}: errors: expected 'independent', 'correlated' or 'simulated'"
            )
        if document["result"] not in _RESULTS:
            raise ValueError(f"{where}: result: expected one of {', '.join(_RESULTS)}")
        equations = document["equations"]
        sizes = {"p": len(names), "n": len(equations) if isinstance(equations, list) else 0}
        fields = {
            name: _array(document[name], name, tuple(sizes[axis] for axis in axes), where)
            for name, axes in _ARRAYS.items()
        }
        result = getattr(RESULTS, document["result"])
        return cls(**fields, result=result, names=tuple(names), errors=document["errors"])

    def __repr__(self) -> str:
        if isinstance(self.k, Tracer) or self.k.ndim != 1:
            count = counted(len(self.names), "coefficient")
            return f"Identification({count}, batch {self.k.shape[:-1]})"
        rms = ", ".join(f"{value:.3g}" for value in np.asarray(self.torque_error))
        return (
            f"Identification({counted(len(self.names), 'coefficient')}, rank {int(self.rank)},"
            f" condition {float(self.condition):.3g}, torque error per joint [{rms}],"
            f" errors {self.errors})"
        )

    def _repr_html_(self) -> str:
        """Return a table of the coefficients with 95 % intervals, for notebooks."""
        if isinstance(self.k, Tracer) or self.k.ndim != 1:
            return html_table(repr(self), {})
        low, high = self.confidence_interval().T
        columns = {
            "coefficient": self.names,
            "value": np.asarray(self.k),
            "standard error": np.asarray(self.standard_error),
            "from": low,
            "to (95 %)": high,
            "determined": ["yes" if determined else "no" for determined in self.determined],
        }
        return html_table(repr(self), columns)

    def __str__(self) -> str:
        if isinstance(self.k, Tracer) or self.k.ndim != 1:
            return repr(self)
        values = zip(self.names, np.asarray(self.k), np.asarray(self.standard_error), strict=True)
        width = max(len(name) for name in self.names)
        lines = [f"{name:<{width}}  {value:>11.5g} ± {error:.2g}" for name, value, error in values]
        return "\n".join([repr(self), *lines])


def result_of(fit: Identification) -> str:
    """The name of the member of `RESULTS` that a fit ended with; not under `jit`."""
    codes = {name: jax.tree.leaves(getattr(RESULTS, name))[0] for name in _RESULTS}
    (code,) = jax.tree.leaves(fit.result)
    return next(name for name, other in codes.items() if int(code) == int(other))


def _array(value: Any, name: str, shape: tuple[int, ...], where: str) -> Any:
    expected = f"{where}: {name}: expected numbers of shape {shape}"
    try:
        array = np.asarray(value, dtype=float)  # None becomes NaN
    except (TypeError, ValueError):
        raise ValueError(expected) from None
    if array.shape != shape:
        raise ValueError(f"{expected}, got {array.shape}")
    if name in _OPEN:
        array = np.where(np.isnan(array), np.inf, array)
    dtype = _TYPES.get(name, float)
    return as_jax(array.astype(dtype))
