"""The story of a mission (`story`), and one module for each of its stages."""
