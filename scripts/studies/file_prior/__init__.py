"""The robot's file as prior: weak motions, wrong files, coverage, exported bodies."""
