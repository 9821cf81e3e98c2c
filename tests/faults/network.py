"""A network of namespaces: a bridge here, and a namespace with a veth for each node. The observatory meets the others
through relays of our own on the bridge and nowhere else, so that its link can be cut, halved, lossy or late."""

import subprocess

from relay import DelayRelay
from harness import NODES, Harness

NET = "10.77.0"


def sh(*words: str):
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")


class NetworkHarness(Harness):
    """`.1` is the bridge with the simulator; nodes follow from `.11` on."""

    def __init__(self, binary: str, name: str):
        self.bridge = "faults"
        sh("ip", "link", "add", self.bridge, "type", "bridge")
        sh("ip", "address", "add", f"{NET}.1/24", "dev", self.bridge)
        sh("ip", "link", "set", self.bridge, "up")
        self.holders: dict[str, subprocess.Popen] = {}
        hosts, enter = {"simulator": f"{NET}.1"}, {}
        for index, node in enumerate(NODES):
            hosts[node] = f"{NET}.{11 + index}"
            # a process that only keeps its namespace; the nodes enter and leave it
            holder = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
            self.holders[node] = holder
            enter[node] = ["nsenter", "--net", "-t", str(holder.pid), "--"]
            veth = f"v{node[:4]}"
            until_apart(holder.pid)
            sh("ip", "link", "add", veth, "type", "veth", "peer", "name", "eth0", "netns", str(holder.pid))
            sh("ip", "link", "set", veth, "master", self.bridge, "up")
            for words in (["link", "set", "lo", "up"], ["address", "add", f"{hosts[node]}/24", "dev", "eth0"],
                          ["link", "set", "eth0", "up"]):
                sh(*enter[node], "ip", *words)
        super().__init__(binary, name, hosts=hosts, enter=enter, connect={})
        others = [node for node in NODES if node != "observatory"]
        self.delays = {node: DelayRelay(f"{NET}.1", self.ports[node], (hosts[node], self.ports[node])) for node in others}
        self.connect = {node: [self.endpoint(n) for n in others if n != node] for node in others}
        self.connect["observatory"] = [f"tcp/{NET}.1:{self.ports[node]}" for node in others]
        self.nft("flush ruleset")
        self.rules()

    def nft(self, text: str):
        done = subprocess.run([*self.enter["observatory"], "nft", "-f", "-"], input=text, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"nft: {done.stderr.strip()}")

    def rules(self, inward: str = "accept", outward: str = "accept"):
        """The observatory speaks with the bridge only; `inward` and `outward` are further rules."""
        self.nft(f"""flush ruleset
table inet faults {{
  chain inward {{ type filter hook input priority 0; iifname "lo" accept; ip saddr != {NET}.1 drop; {inward}; }}
  chain outward {{ type filter hook output priority 0; oifname "lo" accept; ip daddr != {NET}.1 drop; {outward}; }}
}}
""")

    def cable(self, node: str, state: str):
        """The cable of one host: `down` or `up`."""
        sh("ip", "link", "set", f"v{node[:4]}", state)

    def delay(self, seconds: float):
        for relay in self.delays.values():
            relay.delay_s = seconds

    def heal(self):
        self.delay(0.0)
        self.rules()
        for node in NODES:
            self.cable(node, "up")
        super().heal()

    def fresh_subscriber(self):
        raise NotImplementedError("nothing of this harness's bus is received here")

    def stop(self):
        super().stop()
        for relay in self.delays.values():
            relay.stop()
        for holder in self.holders.values():
            holder.kill()
            holder.wait()
        subprocess.run(["ip", "link", "del", self.bridge], check=False)


def until_apart(pid: int):
    """Waits until the holder has left our namespace."""
    import os
    from wire import wait
    wait("a namespace of its own", lambda: os.readlink(f"/proc/{pid}/ns/net") != os.readlink("/proc/self/ns/net"), 5, 0.01)
