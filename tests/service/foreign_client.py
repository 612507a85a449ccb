"""A client as somebody else would write it: plain Zenoh and JSON, nothing of ours. Argument: an endpoint."""

import json
import sys

import zenoh

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
with zenoh.open(config) as session:
    answers = {}
    for key in ("zone", "command", "config", "health"):
        for reply in session.get(f"ssm/ur3/{key}"):
            answers[key] = [str(reply.ok.encoding), json.loads(reply.ok.payload.to_string())]
    answers["alive"] = [str(reply.ok.key_expr) for reply in session.liveliness().get("ssm/*/alive")]
    answers["modules"] = [
        name for name in sys.modules if name.startswith(("ssm_service", "msgspec", "numpy"))
    ]
print(json.dumps(answers))
