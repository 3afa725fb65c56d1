"""A bucket on this machine: moto's S3 behind a server that counts what goes through it and fails a share of the requests."""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from random import Random
from typing import Any

import fsspec
from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import WSGIRequestHandler, make_server

NAME = "flights"
_ENVIRONMENT = {"AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1"}


class _Quiet(WSGIRequestHandler):
    def log_request(self, *_: object) -> None:
        """A request is no news."""


class Counted:
    """The server's application: requests, those to read counted; share: of them answered by 503."""

    def __init__(self, share: float = 0.0, seed: int = 1) -> None:
        self.share, self.gets, self.failed = share, 0, 0
        self._inner, self._rng, self._lock = DomainDispatcherApplication(create_backend_app), Random(seed), threading.Lock()

    def __call__(self, environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        """Answer a request."""
        with self._lock:
            fails = self._rng.random() < self.share
            self.failed += fails
        if fails:
            start("503 Slow Down", [("Content-Length", "0")])
            return []
        answer = b"".join(self._inner(environ, start))
        if environ["REQUEST_METHOD"] == "GET":
            with self._lock:
                self.gets += 1
        return [answer]


@contextmanager
def bucket(share: float = 0.0) -> Iterator[tuple[fsspec.AbstractFileSystem, Counted]]:
    """A bucket s3://flights while the block lasts, for this process and those that it starts."""
    application = Counted(0.0)
    server = make_server("127.0.0.1", 0, application, threaded=True, request_handler=_Quiet)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    wanted = {**_ENVIRONMENT, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.port}"}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        fs = fsspec.filesystem("s3", skip_instance_cache=True)
        fs.mkdir(NAME)
        application.share = share
        yield fs, application
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            os.environ.update({} if value is None else {name: value})
        fsspec.filesystem("s3").clear_instance_cache()
        server.shutdown()
        thread.join()
        server.server_close()
