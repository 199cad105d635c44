"""A server of S3 by others' hands (moto), which fails when it is asked to.

Prints its port, and ends when its standard input does. `PUT /-/fault` with a JSON object says what becomes of requests for
objects from then on:

    {"unavailable": N}    the next N are answered by 503
    {"slow_s": S}         each waits S seconds
    {"read_only": true}   whoever writes is refused

`GET /-/requests` says how many there were.
"""

import json
import os
import sys
import threading
import time

from moto.server import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import WSGIRequestHandler, make_server

faults = {"unavailable": 0, "slow_s": 0.0, "read_only": False}
requests = 0
lock = threading.Lock()
writing = threading.Lock()
s3 = DomainDispatcherApplication(create_backend_app)


def error(start, status, code):
    body = "<Error><Code>%s</Code><Message>asked to fail</Message></Error>" % code
    start(status, [("Content-Type", "application/xml"), ("Content-Length", str(len(body)))])
    return [body.encode()]


def app(environ, start):
    global requests
    path = environ["PATH_INFO"]
    if path == "/-/fault":
        length = int(environ["CONTENT_LENGTH"])
        with lock:
            faults.update(json.loads(environ["wsgi.input"].read(length)))
        start("200 OK", [("Content-Length", "0")])
        return []
    if path == "/-/requests":
        body = str(requests).encode()
        start("200 OK", [("Content-Length", str(len(body)))])
        return [body]
    with lock:
        requests += 1
        unavailable = faults["unavailable"] > 0
        if unavailable:
            faults["unavailable"] -= 1
    time.sleep(faults["slow_s"])
    writes = environ["REQUEST_METHOD"] in ("PUT", "POST", "DELETE")
    failing = unavailable or (writes and faults["read_only"])
    if failing:
        # Or what is left of the request is taken for the next one.
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
    if unavailable:
        return error(start, "503 Service Unavailable", "SlowDown")
    if writes and faults["read_only"]:
        return error(start, "403 Forbidden", "AccessDenied")
    if writes:
        # Compare and swap in one, as S3 does.
        with writing:
            return s3(environ, start)
    return s3(environ, start)


class Quiet(WSGIRequestHandler):
    def log_request(self, *args):
        pass


def main():
    server = make_server("127.0.0.1", 0, app, threaded=True, request_handler=Quiet)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    print(server.port, flush=True)
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    main()
