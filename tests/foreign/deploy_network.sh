# Runs in a network namespace of its own, as the three hosts of docs/deploy.md: their addresses are on its loopback interface.
set -eu
ip link set lo up
for host in 10.0.0.5 10.0.0.11 10.0.0.12; do ip address add "$host/24" dev lo; done
exec "$@"
