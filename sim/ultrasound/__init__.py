"""Ultrasound of objects of ten kinds (6.3.1).

- `_sonar`: emitter, receivers, and signals.
- `_objects`: kinds of objects, and the paths of their echoes.
- `_echoes`: patterns and classes.
"""

from sim.ultrasound._echoes import Echoes as Echoes, ultrasound as ultrasound
from sim.ultrasound._sonar import Sonar as Sonar
