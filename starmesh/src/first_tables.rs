//! Tables of a first `observatory.toml` that `init` and `import-astra` both write.

/// `[bus]` with what several hosts need.
pub const BUS: &str = "\
[bus]
# This host only: no other one reaches the nodes. Several hosts: this host's own address here, and one of the others under
# connect (docs/deploy.md). Everybody who reaches that address may order: keep it on a network of its own.
listen = [\"tcp/127.0.0.1:7447\"]
# connect = [\"tcp/10.0.0.5:7447\"]
";

/// `[alerts]` with an example of each way out.
pub const ALERTS: &str = "\
[alerts]
# The people who get a message when something needs one: none, until one of these has its # taken away. docs/operator/alerts.md
send_when_observatory_silent_s = 20.0   # then the archive node sends in the place of a dead or hung observatory node
# smtp = { server = \"mail.example.org\", from = \"telescope@example.org\" }
# [[alerts.email]]
# name = \"night\"
# to = [\"ana@example.org\"]
# [[alerts.webhook]]
# name = \"chat\"
# url = \"https://chat.example.org/hooks/abc\"  # gets a POST of JSON, whose field text is for people
# [[alerts.webhook]]
# name = \"phone\"
# format = \"ntfy\"
# url = \"https://ntfy.sh/callisto-4f8a\"        # the topic that the app ntfy follows; choose one that nobody guesses
";
