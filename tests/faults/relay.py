"""Two relays of our own, since the kernel may have no netem and a real server never lies to order.

`AlpacaRelay` stands between a device node and the simulator and spoils answers; `DelayRelay` carries TCP later than
it came.
"""

import http.client
import http.server
import json
import socket
import threading
import time
import urllib.parse

RESET = object()


class AlpacaRelay:
    """Passes Alpaca on; `spoil(member, raw)` (`issafe`, `timesincelastupdate(RainRate)`) may return other bytes, RESET, or None to pass the answer on."""

    def __init__(self, host: str, server: str):
        self.server, self.spoil, self.gone = server, None, False
        self.renumber: dict[int, int] = {}
        # `before(member)` is called before the server is asked, `after(member)` when it has answered; both may take their time
        self.before = self.after = lambda member: None
        # cleared while the server hangs: requests are taken, and answered when it goes on
        self.awake = threading.Event()
        self.awake.set()
        relay = self

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            disable_nagle_algorithm = True

            def do_GET(self):
                relay.pass_on(self)

            do_PUT = do_GET

            def log_message(self, *_):
                pass

        class Server(http.server.ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, request, client_address):
                pass  # clients that give up are what this is for

        self.listen = lambda port: Server((host, port), Handler)
        self.http = None
        self.accept(0)
        self.address = f"{host}:{self.http.server_address[1]}"

    def accept(self, port: int):
        self.http = self.listen(port)
        threading.Thread(target=self.http.serve_forever, kwargs={"poll_interval": 0.2}, daemon=True).start()

    def pass_on(self, asked):
        length = int(asked.headers.get("Content-Length") or 0)
        body = asked.rfile.read(length) if length else None
        self.awake.wait()
        if self.gone:
            asked.connection.shutdown(socket.SHUT_RDWR)
            asked.close_connection = True
            return
        path = asked.path
        for shown, real in self.renumber.items():
            path = path.replace(f"/{shown}/", f"/{real}/", 1)
        member, _, query = path.rpartition("/")[2].partition("?")
        # the age of one sensor is a value of its own
        if sensor := urllib.parse.parse_qs(query).get("SensorName"):
            member = f"{member}({sensor[0]})"
        self.before(member)
        connection = http.client.HTTPConnection(self.server, timeout=60)
        headers = {"Content-Type": asked.headers["Content-Type"]} if body is not None else {}
        connection.request(asked.command, path, body, headers)
        answer = connection.getresponse()
        raw = answer.read()
        connection.close()
        self.after(member)
        spoilt = self.spoil(member, raw) if self.spoil else None
        if spoilt is RESET:
            asked.connection.shutdown(socket.SHUT_RDWR)
            asked.close_connection = True
            return
        raw = raw if spoilt is None else spoilt
        asked.send_response(answer.status)
        asked.send_header("Content-Type", answer.getheader("Content-Type", "application/json"))
        asked.send_header("Content-Length", str(len(raw)))
        asked.end_headers()
        asked.wfile.write(raw)

    def answer_value(self, member: str, value: str):
        """From now on `member` answers this JSON text as its Value."""
        def spoil(asked, raw):
            if asked != member:
                return None
            envelope = json.loads(raw)
            envelope["Value"] = "\0"
            return json.dumps(envelope).replace('"\\u0000"', value).encode()
        self.spoil = spoil

    def change_answer(self, member: str, change):
        """From now on `change(envelope)` edits the answer to `member`."""
        def spoil(asked, raw):
            if asked != member:
                return None
            envelope = json.loads(raw)
            changed = change(envelope)
            return json.dumps(envelope if changed is None else changed).encode()
        self.spoil = spoil

    def hang(self):
        self.awake.clear()

    def refuse(self):
        """Nobody listens any more, and connections that stand end at their next request."""
        self.gone = True
        self.close()

    def honest(self):
        self.spoil, self.gone, self.renumber = None, False, {}
        self.before = self.after = lambda member: None
        self.awake.set()
        if self.http is None:
            self.accept(int(self.address.rsplit(":", 1)[1]))

    def close(self):
        if self.http:
            self.http.shutdown()
            self.http.server_close()
            self.http = None

    def stop(self):
        self.gone = True
        self.awake.set()
        self.close()


class DelayRelay:
    """Carries TCP connections to one place; what comes while `delay_s` is set arrives that much later."""

    def __init__(self, host: str, port: int, to: tuple[str, int]):
        self.to, self.delay_s = to, 0.0
        self.listener = socket.create_server((host, port))
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            try:
                near, _ = self.listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(self.to, timeout=3)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            for one, other in ((near, far), (far, near)):
                for end in (one,):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.carry(one, other)

    def carry(self, one: socket.socket, other: socket.socket):
        queue: list[tuple[float, bytes]] = []
        news = threading.Condition()

        def read():
            while True:
                try:
                    data = one.recv(65536)
                except OSError:
                    data = b""
                with news:
                    queue.append((time.monotonic() + self.delay_s, data))
                    news.notify()
                if not data:
                    return

        def write():
            while True:
                with news:
                    while not queue:
                        news.wait()
                    due, data = queue.pop(0)
                time.sleep(max(0.0, due - time.monotonic()))
                try:
                    if not data:
                        other.shutdown(socket.SHUT_RDWR)
                        return
                    other.sendall(data)
                except OSError:
                    for end in (one, other):
                        try:
                            end.shutdown(socket.SHUT_RDWR)
                        except OSError:
                            pass
                    return

        threading.Thread(target=read, daemon=True).start()
        threading.Thread(target=write, daemon=True).start()

    def stop(self):
        self.listener.close()
