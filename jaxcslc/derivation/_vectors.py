from collections.abc import Callable
from typing import Any, no_type_check


# Vectors of any kind of number: rationals, polynomials, arrays, expressions. Zeros that are part of
# a robot's geometry are plain numbers. What they are multiplied by or added to is left out, so that
# neither polynomials nor generated code grow by them.
Vector = tuple[Any, Any, Any]
Matrix = tuple[Vector, Vector, Vector]  # by rows
Rotation = tuple[Any, Any]  # cosine and sine of an angle
Reduce = Callable[[Any], Any]  # brings a product of polynomials into normal form

ZERO: Vector = (0, 0, 0)

# Functions of single numbers take any kind of number: a check at run time, as in the tests, could
# find nothing, and took nine tenths of a derivation's time.


@no_type_check
def unchanged(x: Any) -> Any:
    """The normal form of numbers that need none."""
    return x


@no_type_check
def is_zero(x: Any) -> bool:
    """Exactly zero; an array never is, so that this never asks for its value."""
    return not hasattr(x, "shape") and x == 0


@no_type_check
def plus(x: Any, y: Any) -> Any:
    return y if is_zero(x) else (x if is_zero(y) else x + y)


@no_type_check
def minus(x: Any) -> Any:
    return 0 if is_zero(x) else -x


@no_type_check
def times(x: Any, y: Any) -> Any:
    return 0 if is_zero(x) or is_zero(y) else x * y


@no_type_check
def signed(sign: int, x: Any) -> Any:
    return x if sign > 0 else minus(x)


def add(x: Vector, y: Vector) -> Vector:
    return plus(x[0], y[0]), plus(x[1], y[1]), plus(x[2], y[2])


def scale(factor: Any, x: Vector) -> Vector:
    return times(factor, x[0]), times(factor, x[1]), times(factor, x[2])


def dot(x: Vector, y: Vector) -> Any:
    return plus(plus(times(x[0], y[0]), times(x[1], y[1])), times(x[2], y[2]))


def cross(x: Vector, y: Vector, reduce: Reduce = unchanged) -> Vector:
    return (
        reduce(plus(times(x[1], y[2]), minus(times(x[2], y[1])))),
        reduce(plus(times(x[2], y[0]), minus(times(x[0], y[2])))),
        reduce(plus(times(x[0], y[1]), minus(times(x[1], y[0])))),
    )


def product(matrix: Matrix, x: Vector) -> Vector:
    """Matrix times vector."""
    return dot(matrix[0], x), dot(matrix[1], x), dot(matrix[2], x)


def rotate_x(x: Vector, rotation: Rotation) -> Vector:
    """Rot(x, angle) times a vector."""
    c, s = rotation
    return (
        x[0],
        plus(times(c, x[1]), minus(times(s, x[2]))),
        plus(times(s, x[1]), times(c, x[2])),
    )


def rotate_z(x: Vector, rotation: Rotation) -> Vector:
    """Rot(z, angle) times a vector."""
    c, s = rotation
    return (
        plus(times(c, x[0]), minus(times(s, x[1]))),
        plus(times(s, x[0]), times(c, x[1])),
        x[2],
    )


def unrotate_x(x: Vector, rotation: Rotation) -> Vector:
    """Rot(x, -angle) times a vector: its components in axes that are rotated by the angle."""
    c, s = rotation
    return (
        x[0],
        plus(times(c, x[1]), times(s, x[2])),
        plus(times(c, x[2]), minus(times(s, x[1]))),
    )


def unrotate_z(x: Vector, rotation: Rotation, reduce: Reduce = unchanged) -> Vector:
    """Rot(z, -angle) times a vector: its components in axes that are rotated by the angle."""
    c, s = rotation
    return (
        reduce(plus(times(c, x[0]), times(s, x[1]))),
        reduce(plus(times(c, x[1]), minus(times(s, x[0])))),
        x[2],
    )


def compose(first: Rotation, second: Rotation, sign: int = 1) -> Rotation:
    """Cosine and sine of the first angle plus, or minus, the second."""
    cos, sin = second[0], signed(sign, second[1])
    return (
        plus(times(first[0], cos), minus(times(first[1], sin))),
        plus(times(first[0], sin), times(first[1], cos)),
    )
