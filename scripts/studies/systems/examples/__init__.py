"""Worked examples, each with a simulator of its own that computes the truth."""

from scripts.studies.systems.examples.cart_pole import CART_POLE as CART_POLE
from scripts.studies.systems.examples.lorenz import LORENZ as LORENZ
from scripts.studies.systems.examples.motor import (
    DC_MOTOR as DC_MOTOR,
    FREE_PERIOD as FREE_PERIOD,
    STRIBECK as STRIBECK,
)
from scripts.studies.systems.examples.quadrotor import QUADROTOR as QUADROTOR
from scripts.studies.systems.examples.tanks import (
    COUPLED_TANKS as COUPLED_TANKS,
    FREE_EXPONENT as FREE_EXPONENT,
)
from scripts.studies.systems.examples.vehicle import (
    SATURATING_TYRES as SATURATING_TYRES,
    VEHICLE as VEHICLE,
)
