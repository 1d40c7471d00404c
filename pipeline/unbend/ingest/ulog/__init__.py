"""PX4 logs (.ulg)."""
