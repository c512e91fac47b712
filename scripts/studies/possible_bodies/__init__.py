"""What it costs in torque that bodies be possible and a URDF hold them."""
