"""Rotations behind positions of joints: inverse kinematics in closed form."""
