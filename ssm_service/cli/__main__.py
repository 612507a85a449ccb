"""``python -m ssm_service.cli``: the same as ``ssm``, without the installed script."""

from . import main

if __name__ == "__main__":
    main()
