"""``python -m ssm_service``: the same as ``ssm``."""

from .cli import main

if __name__ == "__main__":
    main()
