"""``python -m pipeline`` is ``unbend``."""

from pipeline.cli import main

if __name__ == "__main__":
    main()
