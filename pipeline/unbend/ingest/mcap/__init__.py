"""MCAP logs (.mcap) of ROS 2, PX4 and Foxglove."""
