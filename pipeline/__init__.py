"""unbend: removes atmospheric refraction from aerial image observations."""

__version__ = "0.1.0"
