"""The decision, once more: written from the science, the interfaces and the keys of the robot file.

Deliberately slow and plain, on Python numbers and dictionaries, and sharing no code with the package. It
takes what is known of a tick as a dictionary and returns what the service must say. Readings are taken by the
estimator ``nearest``; targets are joint velocities; the arm's own echoes are the caller's to avoid.
"""

from __future__ import annotations

import math
from typing import Any

ZONES = ["green", "yellow", "red", "stop"]
SOURCES = ["joints", "ranges", "obstacles", "target"]
DEFAULT_SOURCES = {
    "joints": {"required": True, "timeout_s": 0.1},
    "ranges": {"required": True, "timeout_s": 0.4},
    "obstacles": {"required": False, "timeout_s": 0.25},
    "target": {"required": False, "timeout_s": 0.5},
}
DEFAULT_SEPARATION = {
    "human_speed_m_s": 1.6,
    "tracked_velocity": False,
    "human_speed_floor_m_s": 0.25,
    "red_scaling": 0.25,
}


def worst(*zones: str) -> str:
    """Return the most severe zone."""
    return max(zones, key=ZONES.index)


def state_of(source: dict[str, Any], timeout: float) -> str:
    """Return ``absent``, ``fresh``, ``stale`` or ``invalid``."""
    if source.get("invalid"):
        return "invalid"
    if source.get("value") is None or source.get("age_s") is None:
        return "absent"
    age = source["age_s"]
    return "fresh" if age >= 0.0 and age <= timeout else "stale"


class SlowMonitor:
    """One profile of a robot, tick by tick.

    Args:
        file: The robot file as ``tomllib`` reads it.
        names: The joints.
        free: Indices of the joints that are not locked.
        fastest: Each joint's greatest speed [rad/s].
        lower: Each joint's least position [rad].
        upper: Each joint's greatest position [rad].
        profile: The profile's name.
        period_s: Time from tick to tick [s].
    """

    def __init__(
        self,
        file: dict[str, Any],
        names: list[str],
        free: list[int],
        fastest: list[float],
        lower: list[float],
        upper: list[float],
        profile: str,
        period_s: float,
    ) -> None:
        self.file, self.names, self.free, self.fastest = file, names, free, fastest
        self.lower, self.upper = lower, upper
        self.profile: dict[str, Any] = file["profiles"][profile]
        self.period = period_s
        self.valid_for = max(0.02, 3.0 * period_s)
        self.sources = {
            name: {"period_s": 0.0, **file.get("sources", {}).get(name, default)}
            for name, default in DEFAULT_SOURCES.items()
        }
        separation = self.profile.get("separation")
        self.separation = None if separation is None else {**DEFAULT_SEPARATION, **separation}
        self.window = self.profile.get("recovery_ticks", 25)
        self.past = ["stop"] * self.window
        self.past_beside = ["stop"] * self.window
        self.past_share: list[tuple[float, dict[str, Any] | None]] = [(0.0, None)] * self.window
        self.command = [0.0] * len(names)
        self.compared: tuple[Any, Any, bool] | None = None

    def step(self, inputs: dict[str, Any], scene: dict[str, Any] | None) -> dict[str, Any]:
        """Decide one tick.

        Args:
            inputs: ``joints``, ``ranges``, ``obstacles``, ``target``, each with ``value``, ``age_s``,
                ``invalid``, ``period_s``; ``overrun_s``, ``duplicate``, ``latched``, ``tick_s``,
                ``transport_s``. ``ranges`` has ``math.inf`` for no echo.
            scene: What the geometry is at the joints' position: ``pairs`` (of the obstacles), ``echoes``
                (each sensor's gradient), ``sensors`` (each one's link and ring), ``corners`` by link.
        """
        states = {name: state_of(inputs[name], self.sources[name]["timeout_s"]) for name in SOURCES}
        reasons, zone = self.waiting(states)
        seen = self.seen(inputs, states, scene)
        zone, nearest = self.by_distance(seen, reasons, zone)
        zone = worst(zone, self.doubts(inputs, states, seen, reasons))
        pairs = self.terms(inputs, states, seen)
        tightest = min(pairs, key=lambda pair: (pair["share"], pair["ratio"]), default=None)
        share = 1.0 if tightest is None else tightest["share"]
        by_share = "green"
        if self.separation is not None:
            by_share = self.zone_of_share(share)
            if by_share != "green":
                reasons.append("separation")
            if states["joints"] != "fresh":
                share = 0.0  # nobody knows where the robot is
        beside = worst(zone, self.disturbed(inputs, reasons))
        zone = worst(beside, by_share)
        self.past = [*self.past, zone][-self.window :]
        self.past_beside = [*self.past_beside, beside][-self.window :]
        self.past_share = [*self.past_share, (share, tightest)][-self.window :]
        in_force = worst(*self.past)
        if in_force != zone:
            reasons.append("recovering")
        if states["target"] != "fresh":
            word = {"absent": "waiting", "stale": "stale", "invalid": "invalid"}[states["target"]]
            reasons.append(f"{word}:target")
        limit, scaling, own_limit = self.limits(in_force)
        return {
            "zone": in_force,
            "momentary_zone": zone,
            "distance": nearest,
            "tracked": min([pair["distance"] for pair in seen["tracked"] or []], default=math.inf),
            "reasons": reasons,
            "states": states,
            "speed_limit": limit,
            "speed_scaling": scaling,
            "share": share,
            "pairs": pairs,
            "velocity": self.velocity(inputs, states, in_force, own_limit, pairs),
        }

    def disturbed(self, inputs: dict[str, Any], reasons: list[str]) -> str:
        """Return what is worth what is no perception: errors of the network, a second service, late ticks."""
        zone = "green"
        if inputs["latched"]:
            reasons.append("latched")
            zone = "stop"
        if inputs["duplicate"]:
            reasons.append("duplicate:service")
            zone = "stop"
        if inputs["overrun_s"] > 0.0:
            reasons.append("overrun")
            zone = worst(zone, "stop" if inputs["overrun_s"] > self.valid_for else "yellow")
        return zone

    def waiting(self, states: dict[str, str]) -> tuple[list[str], str]:
        """Return the reasons of joints and perception that are not fresh, and what they are worth."""
        reasons = []
        for name in ("joints", "ranges", "obstacles"):
            word = {"absent": "waiting", "stale": "stale", "invalid": "invalid"}.get(states[name])
            if word is not None and (word != "waiting" or self.sources[name]["required"]):
                reasons.append(f"{word}:{name}")
        return reasons, "stop" if reasons else "green"

    def seen(
        self, inputs: dict[str, Any], states: dict[str, str], scene: dict[str, Any] | None
    ) -> dict[str, Any]:
        """Return what the fresh sources of perception show of the arm; nothing without fresh joints."""
        found: dict[str, Any] = {"tracked": None, "echoes": None, "silent": []}
        if scene is None or states["joints"] != "fresh":
            return found
        if states["obstacles"] == "fresh":
            found["tracked"] = scene["pairs"]
        if states["ranges"] == "fresh" and scene["sensors"]:
            readings = inputs["ranges"]["value"]
            found["echoes"] = [
                {"index": index, "distance": reading, "gradient": scene["echoes"][index], **sensor}
                for index, (reading, sensor) in enumerate(zip(readings, scene["sensors"], strict=True))
                if not math.isinf(reading)
            ]
            for link, corners in scene["corners"].items():
                rings = [s["ring"] for s in scene["sensors"] if s["link"] == link]
                heard = any(echo["link"] == link for echo in found["echoes"])
                found["silent"].append({"link": link, "rings": rings, "corners": corners, "heard": heard})
        return found

    def by_distance(self, seen: dict[str, Any], reasons: list[str], zone: str) -> tuple[str, float | None]:
        """Return the zone with what the steps by distance make of the nearest thing, and its distance."""
        things = [pair["distance"] for pair in seen["tracked"] or []]
        things += [echo["distance"] for echo in seen["echoes"] or []]
        if not things:
            return zone, None
        nearest = min(things)
        steps = {name: self.profile[name]["distance_m"] for name in ("yellow", "red") if name in self.profile}
        found = "green"
        for name, edge in steps.items():
            if nearest <= edge:
                found = name
        if nearest <= 0.0:
            found = "stop"
            reasons.append("contact")
        elif found != "green":
            reasons.append("distance")
        return worst(zone, found), nearest

    def doubts(
        self, inputs: dict[str, Any], states: dict[str, str], seen: dict[str, Any], reasons: list[str]
    ) -> str:
        """Return what blind spots and contradictions are worth."""
        zone = "green"
        if seen["echoes"] is None:
            return zone
        tracked = seen["tracked"]
        word = self.profile.get("uncovered", "yellow")
        if tracked is None and word != "off" and "assumptions" in self.file:
            # The cones of these rings diverge: something could always be near, and unseen.
            reasons.append("uncovered")
            zone = worst(zone, word)
        if tracked is not None and self.contradicted(inputs, seen):
            reasons.append("disagree")
            zone = worst(zone, self.profile.get("disagree_zone", "red"))
        return zone

    def contradicted(self, inputs: dict[str, Any], seen: dict[str, Any]) -> bool:
        """Tell whether rings and tracker contradicted each other at the newest message of either."""
        newest = inputs["ranges"]["value"], inputs["obstacles"]["value"]
        if self.compared is None or any(a is not b for a, b in zip(newest, self.compared, strict=False)):
            margin, answer = self.profile.get("disagree_margin_m"), False
            echo = min(seen["echoes"], key=lambda one: one["distance"], default=None)
            link = seen["silent"][0]["link"] if echo is None else echo["link"]
            exact = min([p["distance"] for p in seen["tracked"] if p["link"] == link], default=math.inf)
            exact = max(exact, 0.0)  # a contact has no well-defined depth
            least = math.inf if echo is None else echo["distance"]
            if margin is not None:
                apart = exact - least if exact != least else 0.0  # two infinities agree
                answer = apart > margin or (not math.isinf(least) and least - exact > margin)
            self.compared = (*newest, answer)
        return self.compared[2]

    def reaction(self, inputs: dict[str, Any], name: str, period: float) -> float:
        """Return T_r of a source whose measurements come at least this far apart [s]."""
        config = self.file.get("reaction", {})
        sensor = max(period, inputs[name].get("period_s", 0.0), self.sources[name]["period_s"])
        age = max(inputs[name]["age_s"], inputs["joints"]["age_s"])
        tick = max(self.period, inputs["tick_s"])
        transport = max(config.get("transport_s", 0.02), inputs["transport_s"])
        return float(sensor + age + tick + transport + config.get("robot_s", 0.1))

    def stopping(self, share: float) -> tuple[float, float]:
        """Return T_s [s] and the stopping distance for each unit of speed [s], at a share of all limits."""
        time = gain = 0.0
        for index in self.free:
            data = self.file["stopping"][self.names[index]]
            for point in [*data.get("slower", []), data]:
                if point["speed_rad_s"] >= min(share, 1.0) * self.fastest[index] * (1.0 - 1e-12):
                    break
            time = max(time, point["time_s"])
            gain = max(gain, point["distance_rad"] / point["speed_rad_s"])
        return time, gain

    def shares(self) -> list[float]:
        """Return the shares of the limits at which the stopping data change, up to 1."""
        found = {1.0}
        for index in self.free:
            for point in self.file["stopping"][self.names[index]].get("slower", []):
                found.add(min(1.0, point["speed_rad_s"] / self.fastest[index]))
        return sorted(found)

    def terms(
        self, inputs: dict[str, Any], states: dict[str, str], seen: dict[str, Any]
    ) -> list[dict[str, Any]]:
        """Return every pair with its terms, the closing speed that it allows, and its share."""
        law = self.separation
        if law is None:
            return []
        pairs = []
        for pair in seen["tracked"] or []:
            human = law["human_speed_m_s"]
            if law["tracked_velocity"] and pair["velocity"] is not None:
                human = max(law["human_speed_floor_m_s"], math.hypot(*pair["velocity"]))
            reaction = self.reaction(inputs, "obstacles", 0.0)
            pairs.append(self.solved(pair, human, reaction, law["human_uncertainty_m"]))
        for thing in self.from_rings(seen):
            period = max(ring["period_s"] for ring in thing["rings"])
            accuracy = max(ring.get("accuracy_m", 0.0) for ring in thing["rings"])
            reaction = self.reaction(inputs, "ranges", period)
            uncertainty = max(law["human_uncertainty_m"], accuracy)
            pairs.append(self.solved(thing, law["human_speed_m_s"], reaction, uncertainty))
        return pairs

    def from_rings(self, seen: dict[str, Any]) -> list[dict[str, Any]]:
        """Return every echo, and the silence of every link's sensors where nobody else looks.

        Where the profile minds what no sensor sees, silence proves nothing: these rings' cones diverge.
        """
        if seen["echoes"] is None:
            return []
        found = [{**echo, "obstacle": None, "rings": [echo["ring"]]} for echo in seen["echoes"]]
        if seen["tracked"] is None:
            for silent in seen["silent"]:
                reach = min(ring["range_max_m"] for ring in silent["rings"])
                if self.profile.get("uncovered", "yellow") != "off" and "assumptions" in self.file:
                    reach = 0.0
                found.append({**silent, "obstacle": None, "distance": reach, "gradient": None})
        return found

    def solved(
        self, pair: dict[str, Any], human: float, reaction: float, uncertainty: float
    ) -> dict[str, Any]:
        """Return a pair with what S_p allows: the greatest speed v with S_p(v) not above the distance."""
        law = self.separation
        assert law is not None
        greatest = self.closing(pair, None)
        fixed = law["intrusion_m"] + uncertainty + law["robot_uncertainty_m"]
        allowed, spares = 0.0, []
        levels = []
        for share in self.shares():
            time, gain = self.stopping(share)
            spare = pair["distance"] - human * (reaction + time) - fixed
            spares.append(spare)
            speed = spare / (reaction + gain) if spare > 0.0 else 0.0
            levels.append((share, speed))
            allowed = max(allowed, speed if share == 1.0 else min(speed, share * greatest))
        part = 0.0 if allowed <= 0.0 else 1.0 if greatest <= allowed else allowed / greatest
        return {
            **pair,
            "human_speed": human,
            "reaction": reaction,
            "fixed": fixed,
            "levels": levels,
            "spare": max(spares),
            "ratio": math.inf if greatest == 0.0 else allowed / greatest,
            "max_closing_speed": allowed,
            "share": part,
        }

    def closing(self, pair: dict[str, Any], velocity: list[float] | None) -> float:
        """Return a pair's closing speed at a joint velocity; without one, the greatest of all [m/s]."""
        if pair["gradient"] is not None:
            if velocity is None:
                return sum(abs(pair["gradient"][j]) * self.fastest[j] for j in self.free)
            return sum(g * v for g, v in zip(pair["gradient"], velocity, strict=True))
        speeds = []
        for columns in pair["corners"]:
            if velocity is None:
                speeds.append(sum(math.hypot(*columns[j]) * self.fastest[j] for j in self.free))
            else:
                moved = [sum(c[k] * v for c, v in zip(columns, velocity, strict=True)) for k in range(3)]
                speeds.append(math.hypot(*moved))
        return max(speeds)

    def zone_of_share(self, share: float) -> str:
        """Return the zone of σ."""
        assert self.separation is not None
        if share <= 0.0:
            return "stop"
        if share < self.separation["red_scaling"]:
            return "red"
        return "yellow" if share < 1.0 else "green"

    def limits(self, zone: str) -> tuple[list[float], float, list[float]]:
        """Return each joint's limit in any direction, the scaling told to consumers, and a command's limit.

        The steps by distance and the doubts of the last ticks limit every command; the least share of the
        last ticks limits what has no known direction.
        """
        if zone == "stop":
            return [0.0] * len(self.names), 0.0, [0.0] * len(self.names)
        beside = worst(*self.past_beside)
        own, scaling = list(self.fastest), 1.0
        if beside in self.profile:
            own = [min(one, self.profile[beside]["joint_speed_rad_s"]) for one in own]
            scaling = self.profile[beside]["speed_scaling"]
        elif beside != "green" and self.separation is not None:
            red = self.separation["red_scaling"]
            scaling = red if beside == "red" else math.sqrt(red)
            own = [scaling * one for one in own]
        share = 1.0 if self.separation is None else min(part for part, _ in self.past_share)
        limit = [min(one, share * fastest) for one, fastest in zip(own, self.fastest, strict=True)]
        return limit, min(scaling, share), own

    def velocity(
        self,
        inputs: dict[str, Any],
        states: dict[str, str],
        zone: str,
        limit: list[float],
        pairs: list[dict[str, Any]],
    ) -> list[float]:
        """Return the command."""
        wanted = [0.0] * len(self.names)
        if states["target"] == "fresh":
            for index in self.free:
                wanted[index] = inputs["target"]["value"][index]
        if zone == "stop" or states["joints"] != "fresh":
            self.command = [0.0] * len(wanted)
            return self.command
        least = min(part for part, _ in self.past_share)
        held = [pair for part, pair in self.past_share if part == least and pair is not None and part < 1.0]
        factor = self.kept_apart(wanted, pairs + held[-1:])
        self.command = self.limited([factor * w for w in wanted], limit, inputs["joints"]["value"][0])
        return self.command

    def kept_apart(self, wanted: list[float], pairs: list[dict[str, Any]]) -> float:
        """Return the greatest scaling of the wanted velocity at which every pair keeps its separation."""
        quickest = max(abs(w) / f for w, f in zip(wanted, self.fastest, strict=True))
        best = 0.0
        for number, share in enumerate(self.shares()):
            factor = 1.0 if share == 1.0 or quickest == 0.0 else min(1.0, share / quickest)
            for pair in pairs:
                closing = self.closing(pair, wanted)
                if closing > 0.0:
                    factor = min(factor, pair["levels"][number][1] / closing)
            best = max(best, factor)
        return best

    def limited(self, wanted: list[float], fastest: list[float], position: list[float]) -> list[float]:
        """Return the velocity scaled as a whole into the limits of speed, acceleration and position."""
        limits = self.file.get("limits", {})
        acceleration = limits.get("acceleration_rad_s2", 4.0)
        margin = limits.get("position_margin_rad", 0.02)
        factor = 1.0
        for index, want in enumerate(wanted):
            if want == 0.0:
                continue
            if want > 0.0:
                gap = self.upper[index] - margin - position[index]
            else:
                gap = position[index] - margin - self.lower[index]
            if gap <= 0.0:
                factor = 0.0
                continue
            before = self.command[index]
            from_speed = abs(before) if before * want > 0.0 else 0.0
            allowed = min(
                fastest[index],
                from_speed + acceleration * self.period,
                math.sqrt(2.0 * acceleration * gap),
                gap / self.period,
            )
            factor = min(factor, allowed / abs(want))
        return [factor * want for want in wanted]
