"""Who may connect to a live session, and how: origins, tokens, certificates."""

from __future__ import annotations

import asyncio
import re
import ssl
import subprocess
from pathlib import Path

import pytest
from live_session import UDP, WS, config, do, pose, reading, running, sample_frame
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from kinefilter.characters import InputError
from kinefilter.pipeline.live.endpoints import MAX_CONNECTIONS, Access
from kinefilter.pipeline.live.live_config import AccessConfig, LiveConfig
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.messages import format_frame
from kinefilter.pipeline.live.playback import open_sender
from kinefilter.pipeline.live.tally import Event


def test_connections_are_as_many_as_allowed() -> None:
    async def session() -> None:
        async with running(config()) as (run, (_, out)):
            streams = [await connect(str(out)) for _ in range(MAX_CONNECTIONS)]
            with pytest.raises(InvalidStatus, match="503"):
                await connect(str(out))
            assert run.tally.events[Event.REFUSED] == 1
            await streams[0].close()
            async with reading(out):
                pass
            for stream in streams:
                await stream.close()

    do(session())


def test_pages_of_other_sites_are_refused_and_those_of_this_machine_are_not() -> None:
    access = AccessConfig(origin=("https://studio.example",))

    async def session() -> None:
        async with running(config(source=WS), access) as (run, places):
            for address in places:
                for origin in ("https://evil.example", "null", "http://localhost.evil"):
                    with pytest.raises(InvalidStatus, match="403"):
                        await connect(str(address), origin=origin)  # type: ignore[arg-type]
                for origin in ("http://localhost:8000", "https://studio.example"):
                    stream = await connect(str(address), origin=origin)  # type: ignore[arg-type]
                    await stream.close()
            assert run.tally.events[Event.REFUSED] == 6

    do(session())


def test_where_others_may_connect_a_token_is_needed(tmp_path: Path) -> None:
    token = "0123456789abcdef"
    (tmp_path / "token").write_text(f"{token}\n", encoding="utf-8")
    access = AccessConfig(bind="127.0.0.1", token_file=tmp_path / "token")
    bearer = {"Authorization": f"Bearer {token}"}

    async def session() -> None:
        async with running(config(source=WS), access) as (run, (source, out)):
            for address in (source, out):
                for wrong in ("", "?token=", "?token=0123456789abcdeF", "?x=y"):
                    with pytest.raises(InvalidStatus, match="401"):
                        await connect(f"{address}/{wrong}")
            assert run.tally.events[Event.REFUSED] == 8
            async with connect(f"{out}/?token={token}") as stream:
                await stream.recv()
                async with open_sender(source, token_file=tmp_path / "token") as send:
                    assert await send(format_frame(sample_frame(0)))
                    assert (await pose(stream))["body"] == "1"
            async with reading(out, additional_headers=bearer):
                pass
            with pytest.raises(InputError, match="--token-file"):
                async with open_sender(source):
                    pass

    do(session())


def test_a_new_token_is_made_where_others_may_connect_and_none_was_given() -> None:
    tokens = [
        Session(config(source=WS), AccessConfig(bind="0.0.0.0")).endpoints.access.token
        for _ in range(2)
    ]
    assert all(token is not None and len(token) >= 32 for token in tokens)
    assert tokens[0] != tokens[1]
    assert Session(config(source=WS)).endpoints.access.token is None


def test_tokens_too_short_to_hold_are_refused(tmp_path: Path) -> None:
    for text in ("", "secret", "a b " * 10, "é" * 20):
        (tmp_path / "token").write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match="expected a token"):
            Session(config(), AccessConfig(token_file=tmp_path / "token"))


def test_with_a_certificate_connections_are_encrypted(tmp_path: Path) -> None:
    files = _certificate(tmp_path)
    access = AccessConfig(certificate=files[0], key=files[1])

    async def session() -> None:
        async with running(config(source=WS), access) as (_, (source, out)):
            assert source.scheme == out.scheme == "wss"
            trusted = ssl.create_default_context(cafile=files[0])
            async with (
                reading(out, ssl=trusted) as stream,
                open_sender(source, certificate=files[0]) as send,
            ):
                assert await send(format_frame(sample_frame(0)))
                assert (await pose(stream))["time"] == 0.0
            with pytest.raises(ssl.SSLCertVerificationError):
                await connect(str(out))

    do(session())


def _certificate(folder: Path) -> tuple[Path, Path]:
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
    curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
    command = ["openssl", "req", "-x509", *curve, "-noenc", "-days", "1", *subject]
    try:
        subprocess.run(
            [*command, "-keyout", str(key), "-out", str(certificate)],
            check=True,
            capture_output=True,
        )
    except FileNotFoundError:
        pytest.skip("openssl, which makes the certificate, is not installed")
    return certificate, key


def test_what_is_no_certificate_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.pem").write_text("nothing", encoding="utf-8")
    for path in (tmp_path / "c.pem", tmp_path / "absent.pem"):
        with pytest.raises(InputError, match="PEM"):
            Session(config(), AccessConfig(certificate=path))


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (LiveConfig(("udp://0.0.0.0:1",), ("-",)), "--bind 0.0.0.0"),
        (LiveConfig(("http://x:1",), ("-",)), "udp://HOST:PORT"),
        (LiveConfig(("vmc://127.0.0.1:1",), ("-",)), "udp://HOST:PORT"),
        (LiveConfig(("-",), ("udp://127.0.0.1:1",)), "vmc://HOST:PORT"),
        (LiveConfig(("-",), ("wss://127.0.0.1:1",)), "--certificate"),
        (LiveConfig(("-",), ()), "--out"),
        (LiveConfig(("-",), ("-",), bodies=0), "--bodies 0"),
        (LiveConfig(("-",), ("-",), height=175.0), "outside 0.3 to 3 m"),
        (LiveConfig(("-",), ("-",), mass=1e9), "mass"),
        (LiveConfig(("-",), ("-",), scene="nowhere"), "nowhere"),
    ],
)
def test_what_cannot_run_is_refused_before_anything_listens(
    what: LiveConfig, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        asyncio.run(Session(what).run(asyncio.Event()))


@pytest.mark.parametrize("name", ["origin", "token_file", "certificate", "key"])
def test_what_only_websockets_have_is_refused_without_one(name: str) -> None:
    value = ("null",) if name == "origin" else Path("nowhere")
    access, told = AccessConfig(**{name: value}), f"--{name.replace('_', '-')} needs a"
    with pytest.raises(InputError, match=f"{told} WebSocket"):
        Session(config("-", source=UDP), access)


def test_a_port_in_use_is_told() -> None:
    async def session() -> None:
        async with running(config(source=WS)) as (_, (source, _)):
            again = config(source=str(source))
            with pytest.raises(InputError, match="cannot listen there"):
                await Session(again).run(asyncio.Event())

    do(session())


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    for out in (WS, "vmc://127.0.0.1:1"):
        with pytest.raises(InputError, match=re.escape("kinefilter[live]")):
            Session(config(out, source=UDP))


def test_tokens_are_compared_whole() -> None:
    from websockets.datastructures import Headers

    access = Access(token="0123456789abcdef")
    right = Headers(Authorization="Bearer 0123456789abcdef")
    assert access.grants("/", right)
    for wrong in ("Bearer 0123456789abcde", "Basic 0123456789abcdef", "", "Bearer é"):
        assert not access.grants("/", Headers(Authorization=wrong))


def test_play_hears_only_this_machine() -> None:
    """Its ``--bind`` is the page's."""
    with pytest.raises(InputError, match=r"write 127\.0\.0\.1"):
        Session(LiveConfig(("udp://0.0.0.0:1",), ()), shown=True)
