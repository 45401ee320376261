"""Who may come in to a page of ours, and what every answer says of it.

A page elsewhere in the person's browser can reach a local port: so the names of the host and the origin are looked at,
and nothing runs that is not ours (the content security policy).
"""

import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


class Door:
    """Lets in who asks for this host from a page of its own, with the token where one is needed.

    Args:
        app: what is behind.
        names: the hosts that may be asked for, with the port; None for any.
        token: empty where none is needed.
        cookie: the name of the token's cookie: browsers keep them for a host, whatever the port.
        entrance: the path at which the token is given, and below which alone it is needed.
        encrypted: those of the hosts that are reached through TLS, by a proxy, and in no other way.
    """

    def __init__(
        self,
        app: Any,
        names: frozenset[str] | None,
        token: str,
        cookie: str,
        entrance: str = "/",
        encrypted: frozenset[str] = frozenset(),
    ):
        self._app, self._names, self._token, self._cookie = app, names, token, cookie
        self._entrance, self._encrypted = entrance, encrypted

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        why_not = self._reason(scope, headers)

        async def with_headers(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                told = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    told.setdefault(name, value)  # a page that is more than ours says what may run in it
            await send(message)

        if why_not is None:
            await self._app(scope, receive, with_headers)
        elif scope["type"] == "http":
            await why_not(scope, receive, with_headers)
        else:
            await send({"type": "websocket.close", "code": 1008})

    def _reason(self, scope: Scope, headers: Headers) -> Response | None:
        """The answer to who may not come in."""
        host, origin = headers.get("host", "").lower(), headers.get("origin")
        if self._names is not None and host not in self._names:
            return PlainTextResponse("another host is meant\n", 421)
        ours = {f"https://{host}"} if host in self._encrypted else {f"http://{host}", f"https://{host}"}
        if scope["type"] == "websocket" and (origin is None or origin.lower() not in ours):
            return PlainTextResponse("another page asks\n", 403)
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD"):
            return PlainTextResponse("only to be read\n", 405)
        if not self._token or not self._is_inside(scope["path"]):
            return None
        given = QueryParams(scope["query_string"]).get("token", "")
        if scope["type"] == "http" and scope["path"] == self._entrance and self._is_token(given):
            answer = RedirectResponse(self._entrance, 303)
            answer.set_cookie(
                self._cookie,
                self._token,
                path=self._entrance,
                httponly=True,
                samesite="strict",
                secure=host in self._encrypted,
            )
            return answer
        cookies = Request({**scope, "type": "http"}).cookies
        if not self._is_token(cookies.get(self._cookie, "")):
            return PlainTextResponse("open the address with its token, as it was printed\n", 403)
        return None

    def _is_inside(self, path: str) -> bool:
        return path == self._entrance or path.startswith(self._entrance.rstrip("/") + "/")

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="surrogatepass"), self._token.encode())
