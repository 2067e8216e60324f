"""An OPC UA server of a run: which clients may read, and what cannot be served."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hil.command_line import typed
from tests.hil.opcua_peers import Server, make_certificate, served
from tests.hil.streamed_run import StreamedRun, finished_run

pytest.importorskip("asyncua", reason="asyncua is not installed")

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

NAMESPACE = "urn:hil-rig:runs"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> StreamedRun:
    return finished_run(tmp_path_factory.mktemp("finished"), 20)


@pytest.fixture(scope="module")
def server(finished: StreamedRun) -> Iterator[Server]:
    with served(finished) as made:
        yield made


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Path]]:
    folder = tmp_path_factory.mktemp("certificates")
    return {
        "rig": make_certificate(folder, "rig"),
        "ours": make_certificate(folder, "ours"),
        "strange": make_certificate(folder, "strange"),
        "ec": make_certificate(folder, "ec", kind="ec"),
        "nameless": make_certificate(folder, "nameless", uri=False),
        "locked": make_certificate(folder, "locked", password=b"secret"),
        "old": make_certificate(folder, "old", days=-1),
    }


async def _reads(url: str, pair: tuple[Path, Path] | None, name: str, user: tuple[str, str] | None = None) -> bool:
    """Return True where such a client reads a value; False where it is refused."""
    client = Client(url)
    if pair is not None:
        client.application_uri = f"urn:test:{name}"
        await client.set_security(SecurityPolicyBasic256Sha256, str(pair[0]), str(pair[1]))
    if user is not None:
        client.set_user(user[0])
        client.set_password(user[1])
    try:
        async with client:
            index = await client.get_namespace_index(NAMESPACE)
            return math.isfinite(await client.get_node(f"ns={index};s=signal/heartbeat").read_value())
    except (ua.UaError, ConnectionError, TimeoutError):
        return False


async def test_beyond_this_machine_only_known_clients_read_over_an_encrypted_channel(
    finished: StreamedRun, pairs: dict[str, tuple[Path, Path]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_OPCUA_PASSWORD", "s3cret/@word")
    certificate, key = pairs["rig"]
    trusted = pairs["ours"][0]
    options = ("--cert", certificate, "--key", key, "--trust", trusted)
    with served(finished, "opc.tcp://plant@0.0.0.0:0/", *options) as server:
        url = server.url.replace("0.0.0.0", "127.0.0.1")
        assert "plant" not in url and "s3cret" not in url
        right, wrong = ("plant", "s3cret/@word"), ("plant", "s3cret/@wore")
        assert await _reads(url, pairs["ours"], "ours"), "a trusted application"
        assert await _reads(url, pairs["strange"], "strange", right), "the right password"
        assert not await _reads(url, pairs["strange"], "strange"), "a stranger"
        assert not await _reads(url, (trusted, pairs["strange"][1]), "ours"), "a certificate without its key"
        assert not await _reads(url, pairs["strange"], "strange", wrong), "the wrong password"
        assert not await _reads(url, pairs["strange"], "strange", ("admin", "")), "a name that asyncua knows"
        assert not await _reads(url, None, "", right), "a password in clear"
        assert not await _reads(url, None, ""), "nobody"


async def test_a_user_of_a_server_on_this_machine_needs_its_password(
    finished: StreamedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_OPCUA_PASSWORD", "s3cret")
    with served(finished, "opc.tcp://plant@127.0.0.1:0/") as server:
        assert await _reads(server.url, None, "", ("plant", "s3cret"))
        assert not await _reads(server.url, None, "", ("plant", "other"))
        assert not await _reads(server.url, None, "")


@pytest.mark.parametrize(
    ("to", "options", "said"),
    [
        ("opc.tcp://0.0.0.0:4840/", (), "0.0.0.0 can be reached from other machines, and that needs --cert and --key"),
        ("opc.tcp://[::]/", (), ":: can be reached from other machines"),
        ("opc.tcp://0.0.0.0/", ("--cert", "rig.pem", "--key", "rig-key.pem"), "with a user in the address or --trust"),
        ("opc.tcp://plant@127.0.0.1/", (), "there is no password for user 'plant'; set HIL_OPCUA_PASSWORD"),
        ("opc.tcp://127.0.0.1/", ("--cert", "rig.pem"), "belong together; give both --cert and --key"),
        ("opc.tcp://127.0.0.1/", ("--trust", "ours.pem"), "--trust needs a certificate of the server"),
        ("opc.tcp://127.0.0.1/", ("--cert", "rig.pem", "--key", "ours-key.pem"), "is not the key of"),
        ("opc.tcp://127.0.0.1/", ("--cert", "ec.pem", "--key", "ec-key.pem"), "is no RSA key of 2048 bits or more"),
        ("opc.tcp://127.0.0.1/", ("--cert", "nameless.pem", "--key", "nameless-key.pem"), "has no application URI"),
        (
            "opc.tcp://127.0.0.1/",
            ("--cert", "locked.pem", "--key", "locked-key.pem"),
            "has a passphrase; give one without",
        ),
        ("opc.tcp://127.0.0.1/", ("--cert", "old.pem", "--key", "old-key.pem"), "is not valid at this time"),
        ("opc.tcp://127.0.0.1/", ("--cert", "rig-key.pem", "--key", "rig-key.pem"), "rig-key.pem is no certificate"),
        ("opc.tcp://127.0.0.1/", ("--cert", "rig.pem", "--key", "rig.pem"), "rig.pem is no key in PEM form"),
        (
            "opc.tcp://127.0.0.1/",
            ("--cert", "gone.pem", "--key", "rig-key.pem"),
            "gone.pem cannot be read (No such file",
        ),
        ("opc.tcp://rig.example.org/", (), "'rig.example.org' is no address on which this machine can listen"),
        ("opc.tcp://127.0.0.1:wide/", (), "the address of the server cannot be read"),
        ("opc.tcp:///", (), "the address of the server cannot be read"),
        ("opc.tcp://plant:s3cret@127.0.0.1:4840/?x", (), "the address of the server cannot be read"),
        ("opc.tcp://127.0.0.1/", ("--all",), "leave out --every, --all, --give-up"),
        ("opc.tcp://127.0.0.1/", ("--give-up", "3"), "leave out --every, --all, --give-up"),
        ("mqtt://127.0.0.1/lab", ("--cert", "rig.pem", "--key", "rig-key.pem"), "are for an OPC UA server"),
    ],
)
def test_what_cannot_be_served_is_one_sentence(
    finished: StreamedRun,
    pairs: dict[str, tuple[Path, Path]],
    monkeypatch: pytest.MonkeyPatch,
    to: str,
    options: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.chdir(pairs["rig"][0].parent)
    done = typed("stream", finished.path, "--to", to, *options)
    assert done.returncode == 2
    assert said in done.stderr and len(done.stderr.splitlines()) == 1
    assert "s3cret" not in done.stderr


def test_a_port_in_use_an_address_of_another_machine_and_a_missing_library_are_one_sentence(
    finished: StreamedRun, server: Server, monkeypatch: pytest.MonkeyPatch, pairs: dict[str, tuple[Path, Path]]
) -> None:
    done = typed("stream", finished.path, "--to", server.url)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "of 127.0.0.1 cannot be had (" in done.stderr and "give another address" in done.stderr
    monkeypatch.setenv("HIL_OPCUA_PASSWORD", "s3cret")
    certificate, key = pairs["rig"]
    elsewhere = ("--to", "opc.tcp://plant@192.0.2.7:4840/", "--cert", certificate, "--key", key)
    done = typed("stream", finished.path, *elsewhere)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "port 4840 of 192.0.2.7 cannot be had (" in done.stderr
    monkeypatch.setitem(sys.modules, "asyncua", None)
    done = typed("stream", finished.path, "--to", "opc.tcp://127.0.0.1/")
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "needs the package asyncua, which is not installed; pip install 'hil-rig[opcua]'" in done.stderr
