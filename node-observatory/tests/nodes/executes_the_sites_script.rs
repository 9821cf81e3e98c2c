//! A site's own script on real nodes: it opens and waits as SPECULOOS needs it, and whatever it does, everything closes
//! in time.

use std::path::{Path, PathBuf};
use std::time::Instant;

use bus::Latest;
use contract::observatory::{Alerts, RowStatus};
use contract::{Address, Key, Part};
use serde_json::json;

use crate::MOST;
use crate::sim::{Sim, telescope};

/// A minute of the night in a second.
const SPEED: f64 = 60.0;
const LISTED: &str = "vendor_commands = [\"command_string STATUS_LIST\", \"command_string CLEAR_ERRORS *\", \
                      \"command_string READY_STATE\"]\n";

fn example(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/sites/speculoos").join(file)
}

/// A site with a script, before its nodes start.
pub async fn site(hooks: &str, script: &str) -> (Sim, Latest<Alerts>) {
    let mut options = telescope(SPEED);
    options.dome.shutter_s = 30.0;
    let more = format!("[faults]\nretries = 0\nrest_s = 1\n[hooks]\nscript = \"hooks.rhai\"\n{hooks}");
    let sim = Sim::with_mount(options, &more, LISTED).await;
    std::fs::write(sim.folder.path().join("hooks.rhai"), script).unwrap();
    let alerts = Key::Observatory(Address::new("test", "alpha").unwrap(), Part::Alerts);
    let alerts = sim.bus.latest(&alerts).await.unwrap();
    (sim, alerts)
}

/// The controller of a mount, with errors latched and others that come when these are acknowledged.
fn latch(sim: &Sim, errors: &serde_json::Value, then: &serde_json::Value) {
    let order = json!({"status": "STATUS_LIST", "clear": "CLEAR_ERRORS", "ready": "READY_STATE", "ready_after_s": 90.0,
                       "errors": errors, "then": then});
    sim.simulator.world().set_vendor(Some(serde_json::from_value(order).unwrap()));
}

/// Every PUT that moves or asks the maker's own, such as `openshutter` and `commandstring STATUS_LIST`.
pub fn puts(sim: &Sim) -> Vec<String> {
    let describe = |entry: simulator::Entry| {
        let command = entry.parameters.split('&').find_map(|pair| pair.strip_prefix("Command="));
        command.map_or(entry.member.clone(), |command| format!("{} {command}", entry.member))
    };
    sim.simulator.world().puts_since(0).into_iter().map(describe).collect()
}

fn place(puts: &[String], what: &str) -> Option<usize> {
    puts.iter().position(|put| put == what)
}

/// When the shutter first got a command to close after one to open.
pub fn shut(sim: &Sim) -> Option<Instant> {
    let log = sim.simulator.world().puts_since(0);
    let mut after = log.iter().skip_while(|entry| entry.member != "openshutter");
    after.find(|entry| entry.member == "closeshutter").map(|entry| entry.at)
}

pub fn stands(alerts: &Latest<Alerts>, id: &str) -> Option<String> {
    let raised = alerts.get()?.sample.body.alerts;
    raised.into_iter().find(|alert| alert.id == id && alert.returned_utc.is_none()).map(|alert| alert.cause)
}

fn status(sim: &Sim, row: usize) -> Option<RowStatus> {
    sim.schedule.get()?.sample.body.rows.get(row).map(|row| row.status)
}

/// Opens; when that is done the night has ended, and everything is closed.
pub const OPEN: &[(&str, &str)] = &[("open", "{}")];

#[tokio::test(flavor = "multi_thread")]
async fn opening_acknowledges_latched_errors_and_waits_until_the_mount_is_ready_and_closing_acknowledges_too() {
    let script = std::fs::read_to_string(example("hooks.rhai")).unwrap();
    let (mut sim, alerts) = site("", &script).await;
    let pressure = json!({"entry": "HA|4:HA|4:17|WORKING_PRESSURE_LOST|4|HA", "level": 4});
    let torque = json!({"entry": "DEC|4:DEC|4;DEC.AMPLIFIER[0]|4:21|SAFE_TORQUE_OFF|4|DEC.AMPLIFIER[0]", "level": 4});
    let gps = json!({"entry": "GPS|2:3|MALFORMED_TELEGRAM|2|GPS", "level": 2});
    latch(&sim, &json!([pressure, torque, gps]), &json!([gps]));
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("opened", MOST, |sim| sim.ended(0).is_some()).await;

    let sent = puts(&sim);
    let at = |what: &str| place(&sent, what).unwrap_or_else(|| panic!("no {what} in {sent:#?}"));
    // 4 + 2: the levels count once each; then the error that came after.
    assert!(at("commandstring STATUS_LIST") < at("commandstring CLEAR_ERRORS 6"), "{sent:#?}");
    assert!(at("commandstring CLEAR_ERRORS 6") < at("commandstring CLEAR_ERRORS 2"), "{sent:#?}");
    assert!(at("commandstring CLEAR_ERRORS 2") < at("openshutter"), "{sent:#?}");
    assert!(at("openshutter") < at("unpark") && at("unpark") < at("commandstring READY_STATE"), "{sent:#?}");
    let asked = sent.iter().filter(|put| *put == "commandstring READY_STATE").count();
    assert!(asked >= 2, "it was not ready at once: {sent:#?}");
    assert!(!sim.simulator.world().has_vendor_errors());
    assert_eq!(stands(&alerts, "site-script/open"), None);

    // The schedule has ended, so everything is closed: the error is acknowledged then, too.
    sim.until("closed", MOST, |sim| sim.simulator.world().dome_open() == 0.0 && sim.simulator.world().is_parked())
        .await;
    let sent = puts(&sim);
    let ready = sent.iter().rposition(|put| put == "commandstring READY_STATE").unwrap();
    let closing = &sent[ready..];
    let listed = place(closing, "commandstring STATUS_LIST").unwrap();
    assert!(listed < place(closing, "closeshutter").unwrap(), "{closing:#?}");
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_error_that_nobody_calls_harmless_keeps_the_roof_shut_and_is_reported() {
    let script = std::fs::read_to_string(example("hooks.rhai")).unwrap();
    let (mut sim, alerts) = site("", &script).await;
    latch(&sim, &json!([{"entry": "HA|8:HA|8:99|BEARING_RUNS_DRY|8|HA", "level": 8}]), &json!([]));
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("reported", MOST, |_| stands(&alerts, "site-script/open").is_some()).await;
    sim.until("resting", MOST, |sim| status(sim, 0) == Some(RowStatus::Interrupted)).await;
    let cause = stands(&alerts, "site-script/open").unwrap();
    assert!(cause.contains("HA: BEARING_RUNS_DRY (error 99, level 8) is not known to be harmless"), "{cause}");
    let sent = puts(&sim);
    assert_eq!(place(&sent, "openshutter"), None);
    assert!(sim.simulator.world().has_vendor_errors(), "nothing was acknowledged");

    // A person acknowledges at the controller; the row goes on by itself.
    latch(&sim, &json!([]), &json!([]));
    sim.until("opened", MOST, |sim| sim.ended(0).is_some()).await;
    sim.until("calm", MOST, |_| stands(&alerts, "site-script/open").is_none()).await;
    sim.stop().await;
}

/// Opens and lets the night end; everything must close. Gives the cause of the alert that the script then raises, if any.
async fn closes(hooks: &str, script: &str) -> Option<String> {
    let (mut sim, alerts) = site(hooks, script).await;
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("open", MOST, |sim| sim.simulator.world().dome_open() == 1.0).await;
    sim.until("opened", MOST, |sim| sim.ended(0).is_some()).await;
    sim.until("closing", MOST, |sim| shut(sim).is_some()).await;
    sim.until("closed", MOST, |sim| sim.simulator.world().dome_open() == 0.0 && sim.simulator.world().is_parked())
        .await;
    let cause = stands(&alerts, "site-script/close").or_else(|| stands(&alerts, "site-script/before_close"));
    sim.stop().await;
    cause
}

#[tokio::test(flavor = "multi_thread")]
async fn a_script_that_throws_in_close_is_reported_and_everything_closes() {
    let script = "fn before_close() { note(\"begins\"); }\nfn close() { throw \"I do not know how\"; }";
    let cause = closes("", script).await;
    assert!(cause.as_deref().is_some_and(|cause| cause.contains("I do not know how")), "{cause:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_script_that_loops_for_ever_in_close_keeps_nothing_open() {
    closes("close_wait_s = 2\n", "fn close() { loop { } }").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_script_that_asks_nothing_or_waits_for_the_default_closes() {
    let script = "fn close() { default_close(); note(\"closed\"); }\nfn after_close() { note(\"after\"); }";
    assert_eq!(closes("close_wait_s = 10\n", script).await, None);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_script_that_calls_the_defaults_a_thousand_times_opens_once_and_closes() {
    let script = "fn open() { for n in 0..1000 { default_open(); } }\n\
                  fn close() { for n in 0..1000 { default_close(); } note(\"a thousand times\"); }";
    let (mut sim, alerts) = site("time_limit_s = 3600\nclose_wait_s = 10\n", script).await;
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("opened", MOST, |sim| sim.ended(0).is_some()).await;
    sim.until("closing", MOST, |sim| shut(sim).is_some()).await;
    sim.until("closed", MOST, |sim| sim.simulator.world().dome_open() == 0.0 && sim.simulator.world().is_parked())
        .await;
    for member in ["openshutter", "unpark"] {
        assert_eq!(puts(&sim).iter().filter(|put| *put == member).count(), 1, "{member}: {:#?}", puts(&sim));
    }
    for function in ["open", "close"] {
        assert_eq!(stands(&alerts, &format!("site-script/{function}")), None);
    }
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_script_that_fills_its_memory_in_close_is_reported_and_everything_closes() {
    let script =
        "fn close() { let a = []; loop { let m = #{}; for n in 0..900 { m[`k${n}`] = `value ${n}`; } a.push(m); } }";
    let cause = closes("time_limit_s = 3600\nclose_wait_s = 10\n", script).await;
    assert!(cause.as_deref().is_some_and(|cause| cause.contains("too large")), "{cause:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_script_that_is_stuck_keeps_nothing_open_under_an_unsafe_sky_and_nothing_unlisted_is_sent() {
    // Nothing after the opening: the night does not end while the script still opens.
    let script = "fn after_open() { try { command_string(\"telescope\", \"FIRE\"); } catch (why) { note(why); throw why; } }\n\
                  fn close() { loop { } }";
    let (mut sim, alerts) = site("close_wait_s = 10\n", script).await;
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("reported", MOST, |_| stands(&alerts, "site-script/after_open").is_some()).await;
    let cause = stands(&alerts, "site-script/after_open").unwrap();
    assert!(cause.contains("\"command_string FIRE\" is not in vendor_commands"), "{cause}");
    assert!(!puts(&sim).iter().any(|put| put.contains("FIRE")), "{:#?}", puts(&sim));
    sim.simulator.world().set_unsafe(true);
    sim.until("closing", MOST, |sim| shut(sim).is_some()).await;
    sim.until("closed", MOST, |sim| sim.simulator.world().dome_open() == 0.0).await;
    sim.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_script_that_cannot_be_read_opens_nothing_and_is_reported() {
    let (mut sim, alerts) = site("", "fn befor_open() { }").await;
    sim.write_schedule(OPEN, 18_000.0);
    sim.start().await;
    sim.until("reported", MOST, |_| stands(&alerts, "site-script/script").is_some()).await;
    sim.until("resting", MOST, |sim| status(sim, 0) == Some(RowStatus::Interrupted)).await;
    let cause = stands(&alerts, "site-script/script").unwrap();
    assert!(cause.contains("line 1: no function is called befor_open; did you mean before_open?"), "{cause}");
    assert_eq!(place(&puts(&sim), "openshutter"), None);
    sim.stop().await;
}

#[test]
fn the_example_reads_and_sends_nothing_that_it_does_not_list() {
    let text = std::fs::read_to_string(example("observatory.toml")).unwrap();
    let config = config::parse(&text, &example("")).unwrap();
    let file = config.hooks.script.unwrap();
    let script = node_observatory::hooks::Script::read(&file).unwrap();
    assert_eq!(script.names(), ["open", "is_ready", "before_close"]);
    let listed = &config.telescope[0].vendor_commands;
    for (command, is_listed) in
        [("STATUS_LIST", true), ("CLEAR_ERRORS 6", true), ("READY_STATE", true), ("OPEN", false)]
    {
        let words = contract::device::vendor::Words { command: command.to_owned(), raw: true };
        let command = contract::device::vendor::VendorCommand::CommandString(words);
        assert_eq!(listed.iter().any(|pattern| pattern.allows(&command)), is_listed, "{command:?}");
    }
}
