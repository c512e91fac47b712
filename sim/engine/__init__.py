"""Two engines: C MuJoCo and MJX.

     Machine, Trajectory --> plan --> computer --> hardware --> plant --> SimulatedRecording

- `_simulate`: entry, and the recording with the true motion.
- `_plan`: sample times and random draws; `_computer`: the controller's side.
- `_hardware`: disturbances of a step; `_mjcf`, `_models`: mechanics for MuJoCo.
- `_plant`: C MuJoCo in batches; `_mjx`: one compiled program.
"""
