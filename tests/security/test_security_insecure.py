"""Beyond this machine there is TLS, or a clear word: refused at once, or said in every ``health``."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import zenoh
from security_kit import Process, free_port

RUN = [sys.executable, "-m", "ssm_service.cli", "run"]
WEAK_TLS = """{
  mode: "router",
  listen: { endpoints: ["tls/0.0.0.0:7447"] },
  transport: { link: { tls: { listen_certificate: "x", listen_private_key: "x" } } },
}"""


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--listen", "tcp/0.0.0.0:7447"], "--listen"),
        (["--connect", "tcp/192.0.2.1:7447"], "--connect"),
        (["--zenoh-config", "FILE"], "enable_mtls"),
    ],
)
def test_the_service_refuses_to_be_open_to_all(tmp_path, words, says):
    file = tmp_path / "weak.json5"
    file.write_text(WEAK_TLS)
    command = [*RUN, *(str(file) if word == "FILE" else word for word in words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 2
    assert says in done.stderr
    assert "--insecure" in done.stderr
    assert "ssm keys init" in done.stderr


def test_told_to_be_insecure_it_says_so_in_every_health(tmp_path):
    port, nobody = free_port(), free_port()
    # Beyond this machine by its looks; it leads nowhere.
    words = ["--listen", f"tcp/127.0.0.1:{port}", "--connect", f"tcp/0.0.0.0:{nobody}", "--insecure"]
    service = Process("-m", "ssm_service.cli", "run", *words, "--seconds", "600", state=tmp_path)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    try:
        service.wait_for_line("\nready\n")
        with zenoh.open(config) as session:
            for _ in range(2):
                (reply,) = session.get("ssm/ur3/health", timeout=5.0)
                warnings = json.loads(reply.ok.payload.to_bytes())["warnings"]
                (said,) = [text for text in warnings if text.startswith("insecure:")]
                assert f"tcp/0.0.0.0:{nobody}, without TLS" in said
        assert "insecure:" in service.output()
    finally:
        service.kill()
