"""A service as a stranger would write one: plain Zenoh and JSON, nothing of the package.

Told what to do by JSON lines on stdin; ends when stdin does. ``stamp_ns`` is CLOCK_MONOTONIC here, which all
processes of a machine share, so that a test can tell how old a decision really is.
"""

import argparse
import json
import sys
import threading
import time
import zlib

import zenoh

NAMES = ["shoulder", "elbow", "wrist"]
PUBLISHING = {
    "express": True,
    "priority": zenoh.Priority.REAL_TIME,
    "congestion_control": zenoh.CongestionControl.DROP,
}


def options():
    parser = argparse.ArgumentParser()
    parser.add_argument("--listen")
    parser.add_argument("--connect")
    parser.add_argument("--robot", default="arm")
    parser.add_argument("--producer", default="first")
    parser.add_argument("--rate", type=float, default=400.0)
    parser.add_argument("--valid-ms", type=float, default=40.0)
    parser.add_argument("--patient", action="store_true", help="keep a frozen consumer, and much for it")
    parser.add_argument("--mute", action="store_true", help="answer no queries")
    return parser.parse_args()


def session(args):
    config = zenoh.Config()
    for key, value in {
        "mode": "router" if args.listen else "client",
        "listen/endpoints": [args.listen] if args.listen else [],
        "connect/endpoints": [args.connect] if args.connect else [],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": 10_000 if args.patient else 100,
        "transport/link/tx/keep_alive": 4,
        "transport/link/tx/queue/size/real_time": 16,
        "transport/link/tcp/so_sndbuf": 262_144 if args.patient else 8192,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def crc(key, payload, producer="", seq=0):
    covered = f"{key}\n{producer}\n{seq}\n\n".encode() + payload
    return f"crc32={zlib.crc32(covered):08x}"


class Pretended:
    def __init__(self, args, session):
        self.args = args
        self.session = session
        self.prefix = f"ssm/{args.robot}/"
        self.wish = {"zone": "green", "fault": None, "command": True, "publish": True}
        self.seq = 1000
        self.zone_bytes = self.command_bytes = b""
        self.held, self.delay_s = [], 0.0
        names = [] if args.mute else ["zone", "command", "health", "config", "frames", "evaluate", "reset"]
        self.queryables = {
            name: session.declare_queryable(self.prefix + name, zenoh.handlers.FifoChannel(64))
            for name in names
        }
        self.token = session.liveliness().declare_token(self.prefix + "alive")

    def messages(self):
        fault, stop = self.wish["fault"], self.wish["zone"] == "stop"
        common = {
            "producer": self.args.producer,
            "seq": self.seq,
            "stamp_ns": time.monotonic_ns(),
            "valid_for_ns": int(self.args.valid_ms * 1e6),
            "zone": self.wish["zone"],
            "name": NAMES,
            "robot": "another" if fault == "robot" else self.args.robot,
        }
        zone = {
            **common,
            "profile": "test",
            "distance": 1.0,
            "speed_limit": [0.0 if stop else 1.0] * 3,
            "speed_scaling": 1.0,
            "nearest": None,
            "sources": {},
            "reaction": None,
            "reasons": ["distance"] if stop else [],
        }
        command = {**common, "velocity": [0.0 if stop else 0.5] * 3}
        if fault == "length":
            zone["speed_limit"] = [1.0]
            command["velocity"] = [0.5]
        if fault == "mismatch":
            command["zone"] = "yellow"
        if fault == "unknown_field":
            zone["zonne"] = command["zonne"] = "green"
        return self.encoded(zone, fault), self.encoded(command, fault)

    def encoded(self, message, fault):
        text = json.dumps(message)
        if fault == "json":
            text = text[:-7]
        if fault == "infinite":
            text = text.replace("0.5", "1e999").replace("[1.0", "[1e999")
        return text.encode()

    def publish(self):
        fault = self.wish["fault"]
        step = {"repeat": 0, "backward": -1}.get(fault, 1)
        self.seq += step
        self.zone_bytes, self.command_bytes = self.messages()
        if not self.wish["publish"]:
            return
        # As a network would whose delay grows with every message; queries are answered as ever.
        self.delay_s += self.wish.get("creep_s", 0.0)
        self.held.append((time.monotonic() + self.delay_s, self.seq, self.zone_bytes, self.command_bytes))
        while self.held and self.held[0][0] <= time.monotonic():
            _, seq, zone, command = self.held.pop(0)
            self.put(seq, zone, command)

    def put(self, seq, zone, command):
        fault = self.wish["fault"]
        for name, schema, payload in (("zone", "Zone", zone), ("command", "VelocityCommand", command)):
            if name == "command" and not self.wish["command"]:
                continue
            encoding = "application/json" if fault == "encoding" else f"application/json;ssm.{schema}/1"
            if fault == "delete":
                self.session.delete(self.prefix + name)
                continue
            attachment = self.seal(name, payload, seq)
            if fault == "corrupt":
                payload = payload.replace(b'"seq"', b'"seq" ')
            if fault == "no_crc":
                attachment = None
            self.session.put(
                self.prefix + name, payload, encoding=encoding, attachment=attachment, **PUBLISHING
            )

    def seal(self, name, payload, seq=None):
        return crc(self.prefix + name, payload, self.args.producer, self.seq if seq is None else seq)

    def serve(self):
        for name, queryable in self.queryables.items():
            while (query := queryable.handler.try_recv()) is not None:
                with query:
                    self.answer(name, query)

    def answer(self, name, query):
        key, asked = self.prefix + name, b"" if query.payload is None else query.payload.to_bytes()
        if self.wish["fault"] == "no_crc":
            query.reply(key, self.zone_bytes, encoding="application/json;ssm.Zone/1")
        elif name == "zone":
            encoding, seal = "application/json;ssm.Zone/1", self.seal(name, self.zone_bytes)
            query.reply(key, self.zone_bytes, encoding=encoding, attachment=seal)
        elif name == "command":
            encoding, seal = "application/json;ssm.VelocityCommand/1", self.seal(name, self.command_bytes)
            query.reply(key, self.command_bytes, encoding=encoding, attachment=seal)
        elif name == "config":
            self.reply(query, key, b'{"rate_hz": 400}')
        elif name == "health":
            self.reply(query, key, b'{"not": "a health message"}')
        elif name == "frames":
            query.reply_err(b'{"error": "no fresh joint state"}')
        elif name == "reset":
            head = {"producer": self.args.producer, "seq": 3, "stamp_ns": 0, "robot": self.args.robot}
            text = json.dumps({**head, "cleared": "corruption on in/joints"}).encode()
            query.reply(key, text, attachment=crc(key, text, self.args.producer, 3))
        else:
            entries = json.loads(asked)
            answer = [{"error": f"{len(entries)}:{e['position'][0]}"} for e in entries]
            self.reply(query, key, json.dumps(answer).encode())

    def reply(self, query, key, payload):
        query.reply(key, payload, attachment=crc(key, payload))

    def listen_to_wishes(self):
        for line in sys.stdin:
            self.wish.update(json.loads(line))
        self.wish["end"] = True

    def run(self):
        threading.Thread(target=self.listen_to_wishes, daemon=True).start()
        self.publish()
        print("ready", flush=True)
        period = 1.0 / self.args.rate
        due = time.monotonic()
        while "end" not in self.wish:
            self.publish()
            self.serve()
            due = max(due + period, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))


def main():
    args = options()
    with session(args) as opened:
        Pretended(args, opened).run()


if __name__ == "__main__":
    main()
