//! Every order by each way (the bus, the command line, HTTP) at a real observatory node: the same answer in the same words, and
//! the same record in the audit.

use bus::{Bus, Clock};
use contract::audit::AuditRecord;
use contract::order_form::{ORDERS, OrderForm, ParameterValue};
use contract::{Address, CommandId, Order, Role};
use node::Node;
use orders::NotAccepted;
use serde_json::{Map, Value, json};
use test_support::{LIMIT, PARANAL, RunningNode, block, join, private_bus, until};
use tokio::time::timeout;

use crate::command::starmesh;

const TELESCOPE: &str = "paranal/callisto";
const NIGHT: &str = "{\"device_name\": \"cam\", \"action_type\": \"close\", \"action_value\": {}, \
                     \"start_time\": \"2026-11-20 23:00:00.000\", \"end_time\": \"2026-11-21 09:00:00.000\"}\n";
const WAYS: [&str; 3] = ["bus", "cli", "web"];

/// Values that an order can have at this site, and values that it cannot.
fn cases(form: &OrderForm) -> Vec<Map<String, Value>> {
    let value = |name: &str, is_good: bool| match name {
        "alert" => json!("no-such-alert/x"),
        "camera" => json!(if is_good { "cam" } else { "nobody" }),
        "input" => json!(if is_good { "sun" } else { "wx/Nothing" }),
        "night" => json!(if is_good { "20261120" } else { "20261399" }),
        // A bad one is not even sent by the command line.
        "text" => json!(NIGHT),
        "temperature_c" => json!(-20.0),
        "number" => json!(1),
        _ => json!(5.0),
    };
    let wanted = form.parameters.iter().filter(|parameter| !["instead_of", "of"].contains(&parameter.name));
    let names: Vec<&str> = wanted.map(|parameter| parameter.name).collect();
    let filled = |is_good| names.iter().map(|&name| (name.to_owned(), value(name, is_good))).collect::<Map<_, _>>();
    let (good, bad) = (filled(true), filled(false));
    if good == bad { vec![good] } else { vec![good, bad] }
}

struct Site {
    folder: tempfile::TempDir,
    bus: Bus,
    connect: String,
    url: String,
    nodes: [RunningNode; 2],
}

impl Site {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let camera = block("camera", "cam", "localhost:1", "temperature_c = -20.0\n");
        let text = format!("{PARANAL}[web]\nlisten = \"127.0.0.1:0\"\n[schedule]\nfile = \"night.jsonl\"\n{camera}");
        std::fs::write(folder.path().join("night.jsonl"), "// nothing\n").unwrap();
        let config = config::parse(&text, folder.path()).unwrap();
        let bus = private_bus(Clock::machine_clock()).await;
        let node = |role, bus| Node::new(role, "main".parse().unwrap(), config.clone(), Default::default(), bus);
        let observatory = RunningNode::live(node(Role::Observatory, join(&bus).await), node_observatory::run);
        let web = RunningNode::live(node(Role::Web, join(&bus).await), node_web::run);
        let url = web.page_url(&bus).await;
        let connect = bus.locators().await.first().unwrap().clone();
        Self { folder, bus, connect, url, nodes: [observatory, web] }
    }

    /// Gives an order by one way; the refusal, if it is refused.
    async fn give(&self, way: &str, form: &OrderForm, given: &Map<String, Value>, reason: &str) -> Result<(), String> {
        match way {
            "bus" => {
                let kind = form.fill(given, reason).map_err(|bad| bad.to_string())?;
                let (id, from) = (CommandId::fresh(), "bus/ana".to_owned());
                let order = Order { id, from, reason: reason.to_owned(), kind, seen: None };
                let address = Address::new("paranal", "callisto").unwrap();
                loop {
                    match orders::give(&self.bus, &address, &order).await {
                        Ok(()) => break Ok(()),
                        Err(NotAccepted::Refused(refusal)) => break Err(refusal.detail),
                        // This session does not know its peers yet.
                        Err(silence) if silence.is_silence() => {}
                        Err(other) => panic!("{}: {other}", form.word),
                    }
                }
            }
            "cli" => {
                let mut words = vec!["order".to_owned(), TELESCOPE.to_owned(), form.word.to_owned()];
                // A schedule is a file on the command line.
                let file = self.folder.path().join("new.jsonl");
                let mut given = given.clone();
                if let Some(Value::String(text)) = given.remove("text") {
                    std::fs::write(&file, text).unwrap();
                    words = ["schedule", "put", TELESCOPE, file.to_str().unwrap()].map(str::to_owned).to_vec();
                }
                for parameter in form.parameters.iter().filter(|parameter| given.contains_key(parameter.name)) {
                    let text = match &given[parameter.name] {
                        Value::String(text) => text.clone(),
                        other => other.to_string(),
                    };
                    let is_option =
                        matches!(parameter.value, ParameterValue::OptionalText | ParameterValue::Number { .. });
                    if is_option {
                        words.push(format!("--{}", parameter.name.replace('_', "-")));
                    }
                    words.push(text);
                }
                if form.closes {
                    words.extend(["--wait", "0"].map(str::to_owned));
                }
                let by = ["--reason", reason, "--operator", "ana", "--no-multicast", "--connect"];
                words.extend(by.map(str::to_owned).into_iter().chain([self.connect.clone()]));
                let output = tokio::task::spawn_blocking(move || starmesh(words)).await.unwrap();
                if output.success { Ok(()) } else { Err(output.err) }
            }
            _ => {
                let body = json!({"command": form.word, "parameters": given, "reason": reason, "operator": "ana"});
                let url = format!("{}/api/v1/telescopes/{TELESCOPE}/commands", self.url);
                let request = reqwest::Client::new().post(url).header("Idempotency-Key", CommandId::fresh().0);
                let response =
                    request.header("Content-Type", "application/json").body(body.to_string()).send().await.unwrap();
                let status = response.status().as_u16();
                let answer: Value = serde_json::from_slice(&response.bytes().await.unwrap()).unwrap();
                match status {
                    202 => Ok(()),
                    409 | 422 => Err(answer["detail"].as_str().unwrap().to_owned()),
                    _ => panic!("{} by HTTP: {status} {answer}", form.word),
                }
            }
        }
    }

    /// What the observatory node has noted first of the order that had this reason.
    fn record(&self, reason: &str) -> Option<AuditRecord> {
        let text =
            std::fs::read_to_string(self.folder.path().join("data/audit-observatory-callisto-main.jsonl")).ok()?;
        text.lines()
            .filter_map(|line| serde_json::from_str::<AuditRecord>(line).ok())
            .find(|record| record.reason == reason)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_order_is_answered_and_noted_alike_by_bus_command_line_and_http() {
    let site = Site::start().await;
    let stop = OrderForm::of("stop").unwrap();
    // The observatory node commands a moment after it has started.
    let commands = async { while site.give("cli", stop, &Map::new(), "").await.is_err() {} };
    timeout(LIMIT, commands).await.expect("the observatory node commands");
    let (mut given_orders, mut refused) = (0, 0);
    for form in ORDERS {
        for given in cases(form) {
            let mut found = Vec::new();
            for way in WAYS {
                // By its reason the record of an order is found.
                let reason = format!("order {given_orders}");
                let answer = timeout(LIMIT, site.give(way, form, &given, &reason)).await.expect("an answer");
                let is_sent = form.fill(&given, &reason).is_ok();
                if is_sent {
                    until("the record", || site.record(&reason).is_some()).await;
                }
                let record = site.record(&reason).map(|record| {
                    assert!(record.from.starts_with(way), "{record:?}");
                    assert_eq!(contract::command::operator(&record.from), "ana");
                    (record.verb, record.parameters, record.outcome)
                });
                assert_eq!(record.is_some(), is_sent, "what no telescope can mean is not sent");
                given_orders += 1;
                refused += u32::from(answer.is_err());
                found.push((answer, record));
            }
            let [(bus, on_bus), (cli, by_cli), (web, by_web)] = &found[..] else { unreachable!() };
            let told = || format!("{} {}: {found:#?}", form.word, Value::Object(given.clone()));
            assert!(on_bus == by_cli && on_bus == by_web, "the records differ: {}", told());
            assert!(bus.is_ok() == cli.is_ok() && bus.is_ok() == web.is_ok(), "the answers differ: {}", told());
            if let (Err(bus), Err(cli), Err(web)) = (bus, cli, web) {
                assert!(
                    !bus.is_empty() && cli.contains(bus.as_str()) && web.contains(bus.as_str()),
                    "the words differ: {}",
                    told()
                );
            }
        }
    }
    assert!(refused >= 9 && refused <= given_orders - 9, "{refused} of {given_orders}");
    for node in site.nodes {
        node.stop().await;
    }
}
