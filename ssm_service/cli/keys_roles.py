"""Who may say and hear what: the roles round a robot, and the access rules that follow for Zenoh."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

DRIVEN: Final = ("in/joints", "in/ranges", "in/obstacles")
TARGETS: Final = ("in/target",)
ECHO: Final = ("in/echo",)
DECIDED: Final = ("zone", "command", "separation")
STATED: Final = ("config", "health")
ANSWERED: Final = ("evaluate", "frames")
"""What the service's evaluating process answers."""

RESET: Final = ("reset",)
ALIVE: Final = ("alive",)

Flow = str
ENTERS: Final[Flow] = "ingress"
LEAVES: Final[Flow] = "egress"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rights:
    """What one role may do, each with the keys below ``ssm/{robot}``.

    Attributes:
        publishes: May put.
        hears: May subscribe.
        asks: May query.
        answers: May be a queryable.
        announces: May declare a liveliness token.
        watches: May ask for liveliness, of every robot: ``ssm/*/alive`` is what clients ask for.
    """

    publishes: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    announces: tuple[str, ...] = ()
    watches: tuple[str, ...] = ()


ROLES: Final[dict[str, Rights]] = {
    # Its own outputs as well, and its own zone: so it notices a second service with its name.
    "service": Rights(
        publishes=DECIDED,
        hears=(*DRIVEN, *TARGETS, *ECHO, "zone", "command"),
        asks=("zone",),
        answers=(*DECIDED, *STATED, *ANSWERED, *RESET),
        announces=ALIVE,
    ),
    # It obeys, so it hears the decision, proves its age by a query, and says when it arrived.
    "driver": Rights(publishes=(*DRIVEN, *ECHO), hears=DECIDED, asks=(*DECIDED, *STATED), watches=ALIVE),
    "commander": Rights(
        publishes=(*TARGETS, *ECHO),
        hears=DECIDED,
        asks=(*DECIDED, *STATED, *ANSWERED, *RESET),
        watches=ALIVE,
    ),
    "viewer": Rights(
        hears=(*DECIDED, *DRIVEN, *TARGETS),
        asks=(*DECIDED, *STATED, *ANSWERED),
        watches=ALIVE,
    ),
    # `ssm sim` stands for a robot's drivers and for whoever plans its motion.
    "simulation": Rights(
        publishes=(*DRIVEN, *TARGETS, *ECHO), hears=DECIDED, asks=(*DECIDED, *STATED), watches=ALIVE
    ),
}

EVALUATING: Final = Rights(hears=("in/joints",), answers=ANSWERED)
"""The service's own evaluating process, on its private socket."""

# What passes at the side that a role is connected to, by right: what enters from it, and what leaves to it.
# Zenoh needs both: a put that may enter is lost if the subscription behind it may not leave.
_MESSAGES: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "publishes": (("put",), ("declare_subscriber",)),
    "hears": (("declare_subscriber",), ("put",)),
    "asks": (("query",), ("declare_queryable", "reply")),
    "answers": (("declare_queryable", "reply"), ("query",)),
    "announces": (("liveliness_token",), ("liveliness_query", "declare_liveliness_subscriber")),
    "watches": (("liveliness_query", "declare_liveliness_subscriber"), ("liveliness_token",)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Party:
    """Somebody at the other end of a link.

    Attributes:
        name: The common name of its certificate, or any name where ``protocol`` needs no certificate.
        rights: What it may do.
        robots: For which robots.
        protocol: Zenoh's name of the link's protocol.
    """

    name: str
    rights: Rights
    robots: tuple[str, ...]
    protocol: str = "tls"


def access_control(others: Sequence[Party], *, mirrored: bool = False) -> dict[str, Any]:
    """Return Zenoh's ``access_control`` section: everything is denied but what the parties may do.

    Args:
        others: Who may be at the other end of a link.
        mirrored: The section is for the parties' own side: ``rights`` are this side's, not the other's.
    """
    rules: list[dict[str, Any]] = []
    policies = []
    for party in others:
        own = list(_rules(party, mirrored=mirrored))
        rules += own
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [party.name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [_subject(party) for party in others],
        "policies": policies,
    }


def _subject(party: Party) -> dict[str, Any]:
    subject: dict[str, Any] = {"id": party.name, "link_protocols": [party.protocol]}
    if party.protocol == "tls":
        subject["cert_common_names"] = [party.name]
    return subject


def _rules(party: Party, *, mirrored: bool) -> Iterator[dict[str, Any]]:
    for right, (entering, leaving) in _MESSAGES.items():
        names: tuple[str, ...] = getattr(party.rights, right)
        robots = ("*",) if right == "watches" else party.robots
        if not names:
            continue
        for flow, messages in ((ENTERS, entering), (LEAVES, leaving)):
            turned = {ENTERS: LEAVES, LEAVES: ENTERS}[flow] if mirrored else flow
            yield {
                "id": f"{party.name} {right}: {turned}",
                "permission": "allow",
                "flows": [turned],
                "messages": list(messages),
                "key_exprs": [f"ssm/{robot}/{name}" for robot in robots for name in names],
            }
