//! Every order and every command that moves hardware leaves a record: on the node's disk, and in the archive, even if
//! it was away meanwhile.

use std::collections::HashMap;
use std::time::Duration;

use audit::audit_file::examine;
use contract::audit::{AuditOutcome, AuditRecord};
use contract::device::{dome, focuser};
use contract::{Address, Command, CommandId, Kind, OrderKind, Reason, Reply, Role};
use serde_json::json;
use test_support::{Harness, HarnessOptions, SITE, TELESCOPE, object, row};

/// Role and id of each node that writes a file of its own.
type Writer = [&'static str; 2];
const ENCLOSURE: Writer = ["device", "enclosure"];
const MAIN: Writer = ["device", "main"];
const OBSERVATORY: Writer = ["observatory", "main"];
/// Its first records: that the audit begins.
const WEB: Writer = ["web", "main"];
const NODES: [Writer; 4] = [ENCLOSURE, MAIN, OBSERVATORY, WEB];
/// A PUT follows its record, or the record the PUT, within so many sky seconds: 3 s on the machine.
const NEAR_S: f64 = 30.0;

fn file(harness: &Harness, [role, id]: Writer) -> std::path::PathBuf {
    harness.path(&format!("data/audit-{role}-{TELESCOPE}-{id}.jsonl"))
}

fn lines(harness: &Harness, node: Writer) -> Vec<String> {
    std::fs::read_to_string(file(harness, node)).unwrap_or_default().lines().map(str::to_owned).collect()
}

fn stored(harness: &Harness, [role, id]: Writer) -> anyhow::Result<Vec<String>> {
    let database = rusqlite::Connection::open(harness.path("data/archive.db"))?;
    let mut statement = database.prepare("SELECT line FROM audit WHERE node = ? AND fault IS NULL ORDER BY rowid")?;
    let rows = statement.query_map([format!("{role}/{TELESCOPE}/{id}")], |row| row.get(0))?;
    Ok(rows.collect::<Result<_, _>>()?)
}

fn records(harness: &Harness, node: Writer) -> anyhow::Result<Vec<AuditRecord>> {
    let found = examine(&std::fs::read(file(harness, node))?, None);
    anyhow::ensure!(found.broken.is_none() && found.half.is_empty(), "{node:?}: {:?}", found.broken);
    Ok(found.good.into_iter().map(|proven| proven.record).collect())
}

/// Sends a command that must be refused; returns its id.
async fn refused<C: contract::Payload>(
    harness: &Harness,
    kind: Kind,
    name: &str,
    token: Option<u64>,
    action: C,
) -> anyhow::Result<CommandId> {
    let device = Address::new(SITE, TELESCOPE)?.device(kind, &name.parse()?);
    let command = Command { id: CommandId::fresh(), from: "web/mallory".to_owned(), token, boot_id: None, action };
    let reply: Reply = harness.bus.ask(&contract::Key::Command(device), &command, Duration::from_secs(3)).await?;
    match reply {
        Reply::Refusal(refusal) if refusal.reason == Reason::StaleToken => Ok(command.id),
        other => anyhow::bail!("{other:?}"),
    }
}

/// The verbs that a PUT may come from, the ones that send it once each first; `None` for a PUT that moves nothing.
fn verbs(member: &str) -> Option<(&'static [&'static str], bool)> {
    Some(match member {
        // The action feeds the dome's watchdog, which moves nothing.
        "connected" | "refresh" | "action" => return None,
        "openshutter" => (&["open_shutter"], true),
        "closeshutter" => (&["close_shutter", "abort_then_close_shutter"], true),
        "park" => (&["park"], true),
        "unpark" => (&["unpark"], true),
        "slewtocoordinatesasync" => (&["slew"], true),
        "synctocoordinates" => (&["sync"], true),
        "startexposure" => (&["expose"], true),
        "position" => (&["turn"], true),
        "move" | "moveabsolute" => (&["move"], true),
        "halt" => (&["abort"], true),
        "opencover" => (&["open_cover"], true),
        "closecover" => (&["close_cover"], true),
        "haltcover" => (&["halt_cover"], true),
        "calibratoron" => (&["calibrator_on"], true),
        "calibratoroff" => (&["calibrator_off"], true),
        "slewtoazimuth" => (&["slew_to_azimuth"], true),
        // Part of something larger, once or more.
        "tracking" => (&["track", "slew", "unpark"], false),
        "rightascensionrate" | "declinationrate" => (&["rates", "slew", "track", "park"], false),
        "abortslew" => (&["abort", "park", "abort_then_close_shutter"], false),
        "abortexposure" | "stopexposure" => (&["abort", "expose"], false),
        "setccdtemperature" | "cooleron" => (&["cool", "warm"], false),
        "binx" | "biny" | "numx" | "numy" | "startx" | "starty" => (&["expose"], false),
        // A member that this list does not contain must not move anything.
        _ => (&[], false),
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn every_order_and_every_movement_of_a_night_leaves_a_record() -> anyhow::Result<()> {
    let mut harness = Harness::new(HarnessOptions::default(), |world| {
        vec![row("open", json!({})), object(world, "Kept field", 10.0, 8), row("close", json!({}))]
    })
    .await?;
    harness.start_all()?;
    let frames = |harness: &Harness| harness.night.get().map_or(0, |night| night.sample.body.frames);
    harness.until("two frames are taken", 120.0, |harness| frames(harness) >= 2).await?;
    let turn = dome::Command::SlewToAzimuth { azimuth_deg: 90.0 };
    let mut bad = vec![refused(&harness, Kind::Dome, "dome", None, turn.clone()).await?];
    bad.push(refused(&harness, Kind::Focuser, "focuser", Some(0), focuser::Command::Move { position: 1 }).await?);

    harness.kill(Role::Archive)?;
    bad.push(refused(&harness, Kind::Dome, "dome", Some(0), dome::Command::OpenShutter).await?);
    harness.order(&["reload", "--reason", "a new target"]).await?;
    harness.until("five frames are taken without an archive", 90.0, |harness| frames(harness) >= 5).await?;
    harness.start(Role::Archive)?;
    harness
        .until("the night ends", 150.0, |harness| harness.night.get().is_some_and(|night| night.sample.body.ended))
        .await?;
    harness.until("the dome is shut", 60.0, Harness::is_shut).await?;
    harness.order(&["close", "--reason", "good night"]).await?;

    let same = |harness: &Harness| {
        NODES
            .iter()
            .all(|node| stored(harness, *node).is_ok_and(|stored| stored.len() > 1 && stored == lines(harness, *node)))
    };
    // The last records are synced and published within seconds, and asked for each minute if they were lost on the way.
    tokio::time::sleep(Duration::from_secs(3)).await;
    harness.until("the archive has what the nodes have, record for record", 90.0, same).await?;

    let ordered = records(&harness, OBSERVATORY)?;
    for (kind, reason) in [(OrderKind::ReloadSchedule, "a new target"), (OrderKind::Close, "good night")] {
        let verb = audit::verb_and_parameters(&kind).0;
        let found = ordered.iter().find(|record| record.verb == verb && record.reason == reason);
        let found = found.ok_or_else(|| anyhow::anyhow!("no record of {verb}: {ordered:#?}"))?;
        assert!(found.from.starts_with("cli/") && found.outcome == AuditOutcome::Accepted, "{found:?}");
    }
    let moved: Vec<AuditRecord> = [records(&harness, ENCLOSURE)?, records(&harness, MAIN)?].concat();
    for id in &bad {
        let found: Vec<_> = moved.iter().filter(|record| record.id == *id).collect();
        assert!(
            matches!(
                found[..],
                [AuditRecord { outcome: AuditOutcome::Refused { reason: Reason::StaleToken, .. }, .. }]
            ),
            "{found:?}"
        );
    }
    let hosts = moved.iter().filter(|record| record.from == "observatory/alpha/main" && !record.from_host.is_empty());
    assert!(hosts.count() > 0, "where the observatory runs is known");

    // Compares every PUT that moved something with the records.
    let mut accepted: Vec<&AuditRecord> =
        moved.iter().filter(|record| record.outcome == AuditOutcome::Accepted).collect();
    let all = accepted.clone();
    let mut seen: HashMap<String, usize> = HashMap::new();
    for put in harness.simulator.world().puts_since(0) {
        let Some((verbs, once)) = verbs(&put.member) else { continue };
        let is_its = |record: &&AuditRecord| {
            record.device.split('/').next() == Some(put.device.path().as_str())
                && verbs.contains(&record.verb.as_str())
                && record.at_utc.seconds_since(put.sky_utc).abs() < NEAR_S
        };
        let found = if once {
            // A record answers for one such PUT, not for two.
            accepted.iter().position(is_its).map(|index| accepted.remove(index))
        } else {
            all.iter().find(|record| is_its(record)).copied()
        };
        assert!(found.is_some(), "no record of {put:?}:\n{all:#?}");
        *seen.entry(put.member).or_default() += 1;
    }
    assert!(
        ["openshutter", "closeshutter", "startexposure", "slewtocoordinatesasync", "park"]
            .iter()
            .all(|member| seen.contains_key(*member)),
        "{seen:?}"
    );
    assert!(seen["startexposure"] >= 8, "{seen:?}");
    // Each of them has a record of how it ended.
    for record in all.iter().filter(|record| record.verb == "expose" || record.verb == "open_shutter") {
        let ended = moved.iter().any(|end| end.id == record.id && end.outcome == AuditOutcome::Done);
        assert!(ended, "{record:?}");
    }

    let [enclosure, main, observatory, web] = NODES.map(|node| file(&harness, node));
    let archive = harness.path("data/archive.db");
    let text = |path: &std::path::Path| path.display().to_string();
    let files = [text(&enclosure), text(&main), text(&observatory), text(&archive), text(&web)];
    let proven = harness.starmesh(&["audit", "verify", &files[0], &files[1], &files[2], &files[3], &files[4]]).await?;
    let distinct: usize = NODES.iter().map(|node| lines(&harness, *node).len()).sum();
    assert!(proven.contains(&format!("{} records, {distinct} of them different ones", 2 * distinct)), "{proven}");
    let shown = harness.starmesh(&["audit", "show", "--device", "dome", &files[0], &files[3]]).await?;
    assert!(shown.contains("dome/dome open_shutter") && shown.contains("web/mallory"), "{shown}");
    assert!(!shown.contains("expose"), "{shown}");

    // One byte, and the command line finds the line.
    let mut bytes = std::fs::read(&enclosure)?;
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let line = bytes[..middle].iter().filter(|byte| **byte == b'\n').count() + 1;
    let spoilt = harness.path("spoilt.jsonl");
    std::fs::write(&spoilt, bytes)?;
    let error = harness.starmesh(&["audit", "verify", &text(&spoilt)]).await.unwrap_err().to_string();
    assert!(error.contains(&format!("line {line} is broken: expected")), "{error}");
    harness.until("the dome ends shut", 30.0, Harness::is_shut).await?;
    Ok(())
}
