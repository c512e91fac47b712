"""Recordings of many simulated machines, and what is made of them.

- `_record`: many recordings in one call, and their files.
- `_closed_loop`: recordings with observations of the controller.
- `_film`, `_linearity`, `_mask_quality`: films, linearity of motors, quality of masks.
"""
