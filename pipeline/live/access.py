"""Who may connect to a WebSocket: tokens, certificates and the origin of pages.

A program sends the token as ``Authorization: Bearer TOKEN``. A page in a browser cannot
set that header and appends ``?token=TOKEN`` to the address.
"""

from __future__ import annotations

import hmac
import re
import secrets
import ssl
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

from kinefilter.characters import InputError
from kinefilter.pipeline.formats.files import read_limited
from kinefilter.pipeline.loopback import OWN_PAGES, is_loopback

if TYPE_CHECKING:
    from websockets.datastructures import Headers

_SHORTEST_TOKEN = 16  # characters; shorter ones can be guessed
_LARGEST_TOKEN_FILE = 2**12  # bytes


@dataclass(frozen=True)
class Access:
    """What somebody who connects has to show."""

    token: str | None = None
    """The secret; None: none is asked for."""
    origins: tuple[str, ...] = ()
    """Pages of these origins may connect beside those of this machine."""
    tls: ssl.SSLContext | None = None
    """The certificate; None: the connection is not encrypted."""

    def grants(self, path: str, headers: Headers) -> bool:
        """Tell whether a request shows the token."""
        if self.token is None:
            return True
        scheme, _, shown = headers.get("Authorization", "").partition(" ")
        if scheme.lower() != "bearer":
            shown = parse_qs(urlsplit(path).query).get("token", [""])[0]
        # As long for every wrong token as for the right one.
        return hmac.compare_digest(shown.strip().encode(), self.token.encode())

    @property
    def allowed_origins(self) -> Sequence[str | re.Pattern[str] | None]:
        """Origins as ``websockets`` takes them; None: no page, but a program."""
        return [None, OWN_PAGES, *self.origins]


def make_access(
    bind: str | None,
    *,
    token_file: Path | None = None,
    certificate: Path | None = None,
    key: Path | None = None,
    origins: Sequence[str] = (),
) -> Access:
    """Return what those who connect have to show.

    Where other machines can connect there is a token: that of the file, or a new one.

    Args:
        bind: The address that is listened on; None: this machine alone.
        token_file: Holds the token.
        certificate: Certificate chain (PEM).
        key: Its private key (PEM); by default in the same file.
        origins: Pages that may connect, such as ``https://studio.example``.

    Raises:
        InputError: A file is missing or wrong.
    """
    token = None if token_file is None else read_token(token_file)
    if token is None and bind is not None and not is_loopback(bind):
        token = secrets.token_urlsafe()
    tls = None if certificate is None else certificate_of(certificate, key)
    return Access(token, tuple(origins), tls)


def read_token(path: Path) -> str:
    """Return the token that a file holds.

    Raises:
        InputError: There is no such file, or its token is too short.
    """
    token = read_limited(path, _LARGEST_TOKEN_FILE).strip()
    if len(token) < _SHORTEST_TOKEN or not token.isascii() or len(token.split()) > 1:
        raise InputError(
            f"{path}: expected a token of {_SHORTEST_TOKEN} letters and digits or "
            "more; 'openssl rand -hex 16' makes one"
        )
    return token


def certificate_of(certificate: Path, key: Path | None) -> ssl.SSLContext:
    """Return what encrypts connections.

    Raises:
        InputError: The files are no certificate and its key.
    """
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        # A key that needs a password would ask for it on the terminal.
        context.load_cert_chain(certificate, key, password="")
    except (ssl.SSLError, OSError) as error:
        reason = error.strerror or error.reason if hasattr(error, "reason") else error
        raise InputError(
            f"{certificate}: no certificate with its key ({reason}); expected PEM "
            "files, the key without a password"
        ) from None
    return context
