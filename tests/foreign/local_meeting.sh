# Runs in a network namespace of its own, which has an address besides loopback: two nodes whose file has no [bus].
set -eu
starmesh=$1 folder=$2
ip link set lo up
ip link set lo multicast on
ip address add 10.0.0.5/32 dev lo
ip route add 224.0.0.0/4 dev lo
cat > "$folder/observatory.toml" <<'TOML'
[observatory]
site = "paranal"
telescope = "alpha"
latitude_deg = -24.6
longitude_deg = -70.4
elevation_m = 2500

[web]
listen = "127.0.0.1:0"
TOML
"$starmesh" node archive --config "$folder/observatory.toml" 2> "$folder/archive.log" & archive=$!
"$starmesh" node web --config "$folder/observatory.toml" 2> "$folder/web.log" & web=$!
trap 'kill $archive $web 2>/dev/null || true' EXIT
timeout 30 "$starmesh" tail --connect tcp/127.0.0.1:7447 --no-multicast 'starmesh/v1/*/*/node/*/*/state' > "$folder/heard.txt" || true
cat "$folder/heard.txt" | cut -c1-200
grep -q 'node/archive/main/state' "$folder/heard.txt"
grep -q 'node/web/main/state' "$folder/heard.txt"
# Every listening socket of this namespace is on 127.0.0.1 (0100007F), and nobody has joined a group for scouting.
awk '$4 == "0A" && $2 !~ /^0100007F:/ { print "listens elsewhere: " $2; bad = 1 } END { exit bad }' /proc/net/tcp
awk '$4 == "0A" { print "listens on IPv6: " $2; bad = 1 } END { exit bad }' /proc/net/tcp6
if grep -q 'E00000E0' /proc/net/igmp; then echo "zenoh's group 224.0.0.224 was joined"; exit 1; fi
