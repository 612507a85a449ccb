"""A consumer in its own process: writes down every yield with its time by the shared monotonic clock."""

import json
import sys
import time

from ssm_service.client import Client


def main():
    endpoint, seconds, file = sys.argv[1], float(sys.argv[2]), sys.argv[3]
    config = sys.argv[4] if len(sys.argv) > 4 else None
    rows = []
    with Client("arm", connect=(endpoint,), zenoh_config=config) as client:
        end = time.monotonic() + seconds
        print("ready", flush=True)
        for followed in client.stream():
            now = time.monotonic_ns()
            message = followed.zone_message
            rows.append(
                {
                    "now": now,
                    "own": followed.stopped_by_consumer,
                    "reasons": followed.reasons,
                    "expires": followed.expires_ns,
                    "stamp": None if message is None else message.stamp_ns,
                    "moving": any(followed.velocity),
                }
            )
            if time.monotonic() > end:
                break
    with open(file, "w") as out:
        json.dump(rows, out)


if __name__ == "__main__":
    main()
