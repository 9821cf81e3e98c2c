# Runs in a network namespace of its own: two nodes and `starmesh tail`, which knows no endpoint either.
set -eu
starmesh=$1 folder=$2
ip link set lo up
ip link set lo multicast on
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
timeout 15 "$starmesh" tail 'starmesh/v1/*/*/node/*/*/state' > "$folder/heard.txt" || true
cat "$folder/heard.txt" | cut -c1-200
grep -q 'node/archive/main/state' "$folder/heard.txt"
grep -q 'node/web/main/state' "$folder/heard.txt"
