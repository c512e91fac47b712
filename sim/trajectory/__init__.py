"""Tasks of simulated machines: paths, controllers, and the thesis's trajectories.

- `_kinematics`: poses and Jacobians of the hand.
- `_paths`, `_motions`: desired paths of joints and of the hand.
- `_torques`: torques beside feedback.
- `_trajectories`: start, controller, path, loads and faults of a simulation.
"""
