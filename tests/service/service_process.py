"""The service in a process of its own, for tests. Argument: the fields of ``ServiceOptions`` as JSON."""

import json
import sys
from pathlib import Path

from ssm_service.errors import SsmError
from ssm_service.service import ServiceOptions, run_service


def main() -> int:
    fields = json.loads(sys.argv[1])
    for path in ("zenoh_config", "state"):
        if path in fields:
            fields[path] = Path(fields[path])
    try:
        run_service(ServiceOptions(**fields), lambda text: print(text, file=sys.stderr, flush=True))
    except SsmError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
