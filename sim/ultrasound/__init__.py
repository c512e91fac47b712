"""Ultrasound of objects of ten kinds (6.3.1).

- `_sonar`: emitter, receivers, and signals.
- `_objects`: kinds of objects, and the paths of their echoes.
- `_echoes`: patterns and classes.
"""
