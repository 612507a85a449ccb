"""A driver as somebody else would write it, with a certificate: plain Zenoh, JSON and a checksum of its own.

Arguments: a Zenoh configuration, the robot's name, and {"joints": [period_s, {fields}], …} as JSON.
"""

import json
import sys
import time
import zlib

import zenoh


def main():
    file, robot, sources = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
    producer = f"driver {time.monotonic_ns()}"
    with zenoh.open(zenoh.Config.from_file(file)) as session:
        due = dict.fromkeys(sources, time.monotonic())
        seq = dict.fromkeys(sources, 0)
        while True:
            for source, (period, fields) in sources.items():
                now = time.monotonic()
                if now < due[source]:
                    continue
                due[source] = max(due[source] + period, now)
                seq[source] += 1
                key = f"ssm/{robot}/in/{source}"
                head = {"producer": producer, "seq": seq[source], "stamp_ns": time.time_ns()}
                payload = json.dumps({**head, **fields}).encode()
                covered = f"{key}\n{producer}\n{seq[source]}\n\n".encode() + payload
                session.put(key, payload, attachment=f"crc32={zlib.crc32(covered):08x}".encode())
            time.sleep(max(0.0, min(due.values()) - time.monotonic()))


main()
