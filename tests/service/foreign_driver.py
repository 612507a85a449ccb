"""A driver as somebody else would write it: plain Zenoh and JSON, nothing of ours. Argument: one JSON object.

endpoint, producer, sources: {"joints": [period_s, {fields}], …}
"""

import json
import sys
import time
import zlib

import zenoh

ROBOT = "ssm/ur3"


def main():
    wanted = json.loads(sys.argv[1])
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([wanted["endpoint"]]))
    with zenoh.open(config) as session:
        begin = time.monotonic()
        due = dict.fromkeys(wanted["sources"], begin)
        seq = dict.fromkeys(wanted["sources"], 0)
        while True:
            for source, (period, fields) in wanted["sources"].items():
                now = time.monotonic()
                if now < due[source]:
                    continue
                due[source] = max(due[source] + period, now)
                seq[source] += 1
                head = {"producer": wanted["producer"], "seq": seq[source], "stamp_ns": time.time_ns()}
                key, payload = f"{ROBOT}/in/{source}", json.dumps({**head, **fields}).encode()
                covered = f"{key}\n{head['producer']}\n{head['seq']}\n\n".encode() + payload
                session.put(key, payload, attachment=f"crc32={zlib.crc32(covered):08x}")
            time.sleep(max(0.0, min(due.values()) - time.monotonic()))


main()
