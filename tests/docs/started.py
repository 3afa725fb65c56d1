"""`landfix` for the commands of a page: a process that has imported everything forks one for each command.

A program that starts imports for seconds. The command is the same: arguments, folder, environment and streams are the caller's.
Its `__main__` is no file (python -c), so that processes that a command spawns import nothing of the tests.
"""

import json
import os
import socket
import sys
from typing import Final

_MOST_BYTES: Final = 1 << 20
_STREAMS: Final = 3

# A program in a page's folder, which needs no package: {python}, {socket}.
PROGRAM: Final = """#!{python} -SE
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect({socket!r})
    socket.send_fds(server, [json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()], [0, 1, 2])
    sys.exit(int(server.recv(8) or b"1"))
"""


def _answered(listener: socket.socket) -> None:
    """Fork for each command, one after the other; returns in the child, with all that is the caller's."""
    while True:
        caller, _ = listener.accept()
        with caller:
            data, streams, *_ = socket.recv_fds(caller, _MOST_BYTES, _STREAMS)
            child = os.fork()
            if child == 0:
                break
            for stream in streams:
                os.close(stream)
            _, status = os.waitpid(child, 0)
            caller.sendall(str(os.waitstatus_to_exitcode(status)).encode())
    words, folder, environment = json.loads(data)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["landfix", *words]


def main() -> None:
    """Say that it is ready, and serve until the process is ended."""
    import matplotlib.pyplot  # noqa: F401, PLC0415  (all that commands import when they run)

    import vision.pipeline  # noqa: F401, PLC0415
    from estimator import cli  # noqa: PLC0415
    from estimator.service.warm_up import warm_up  # noqa: PLC0415

    warm_up()
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(sys.argv[1])
        listener.listen()
        print("ready", flush=True)
        _answered(listener)
    cli.main()
