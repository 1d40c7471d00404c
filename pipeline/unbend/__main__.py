"""``python -m unbend`` is ``unbend``."""

from unbend.cli import main

if __name__ == "__main__":
    main()
