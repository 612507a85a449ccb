"""Beyond this machine there is TLS, or a clear word: refused at once, or said in every ``health``."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import zenoh
from security_kit import Process, free_port

from ssm_service.errors import ConfigError
from ssm_service.service import ServiceOptions, run_service

RUN = [sys.executable, "-m", "ssm_service.cli", "run"]
WEAK_TLS = """{
  mode: "router",
  listen: { endpoints: ["tls/0.0.0.0:7447"] },
  transport: { link: { tls: { listen_certificate: "x", listen_private_key: "x" } } },
}"""


def test_the_service_refuses_to_be_open_to_all():
    done = subprocess.run([*RUN, "--listen", "tcp/0.0.0.0:7447"], capture_output=True, text=True, timeout=100)
    assert done.returncode == 2
    for words in ("--listen", "tcp/0.0.0.0:7447, without TLS", "--insecure", "ssm keys init"):
        assert words in done.stderr


def test_it_reads_what_it_dials_and_what_a_file_says(tmp_path):
    file = tmp_path / "weak.json5"
    file.write_text(WEAK_TLS)
    with pytest.raises(ConfigError, match=r"--connect: found 'tcp/192\.0\.2\.1:7447, without TLS'"):
        run_service(ServiceOptions(connect=("tcp/192.0.2.1:7447",)), print)
    with pytest.raises(ConfigError, match=r"weak\.json5: listen/endpoints: .*enable_mtls is not true"):
        run_service(ServiceOptions(zenoh_config=file), print)


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
