"""Simulated machines, with all disturbances of Section 7.2.

- `_machine`: `Machine`, whose fields are off by default.
- `_bodies`, `_nearest_links`: links that exist, and links with given dynamics.
- `_drivetrain`: drives, encoders, transmission, friction.
- `_events`: loads and faults.
- `_puma560`, `_thesis_machines`, `_disturbances`: machines and disturbances by name.
"""
