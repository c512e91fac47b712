"""Elastic gears: rotor and link of a joint as two bodies."""

from ._elastic_equations import ElasticEquations as ElasticEquations
from ._parameters import TransmissionParameters as TransmissionParameters
from ._transmission import (
    Transmission as Transmission,
    transmission_lines as transmission_lines,
)
