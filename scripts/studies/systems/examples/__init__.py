"""Worked examples, each with a simulator of its own that computes the truth."""

from .cart_pole import CART_POLE as CART_POLE
from .lorenz import LORENZ as LORENZ
from .motor import DC_MOTOR as DC_MOTOR, FREE_PERIOD as FREE_PERIOD, STRIBECK as STRIBECK
from .quadrotor import QUADROTOR as QUADROTOR
from .tanks import COUPLED_TANKS as COUPLED_TANKS, FREE_EXPONENT as FREE_EXPONENT
from .vehicle import SATURATING_TYRES as SATURATING_TYRES, VEHICLE as VEHICLE
