//! Commands of a maker's own: only what is listed is sent, and the answer comes back.

use contract::device::dome::{self, Dome};
use contract::device::vendor::{VendorCommand, Words};
use contract::{CommandOutcome, Kind, Reason, Reply};
use serde_json::json;

use crate::fake::FakeAnswer;
use crate::stage::{Commander, Stage, accepted, command, refused};
use crate::{a_dome, block};

const LISTED: &str = "period_s = 0.5\nvendor_commands = [\"command_string STATUS\"]\n\
                      vendor_commands_to_close = [\"command_string RESET *\"]";

async fn ask(stage: &Stage, id: &str, token: Option<u64>, text: &str) -> Reply {
    let words = Words { command: text.to_owned(), raw: true };
    let action = dome::Command::Vendor(VendorCommand::CommandString(words));
    stage.command(Kind::Dome, "dome", &command(id, token, action)).await
}

/// How a command ended, and what was answered.
async fn ended(stage: &Stage, id: &str) -> (CommandOutcome, Option<String>) {
    let is_over = |last: &contract::LastCommand| last.id.0 == id && last.outcome != CommandOutcome::Running;
    let state = stage.until::<Dome>("dome", |state| state.last_command.as_ref().is_some_and(is_over)).await;
    let last = state.last_command.unwrap();
    (last.outcome, last.answer)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_of_the_makers_own_needs_the_token_and_the_permit_and_to_be_listed_and_is_answered() {
    let hardware = a_dome().await;
    hardware.answer("put commandstring", FakeAnswer::Value(json!("axis|4,axis|2")));
    let stage = Stage::start(&block("dome", "dome", &hardware, LISTED)).await;
    stage.until::<Dome>("dome", |state| state.link == contract::Link::Connected).await;
    let token = accepted(&stage.command(Kind::Dome, "dome", &command("c", None, dome::Command::Claim)).await);

    // Without a permit only what closing may need, and never without the token.
    assert_eq!(refused(&ask(&stage, "a", token, "STATUS").await), Reason::NoPermit);
    assert_eq!(refused(&ask(&stage, "b", None, "RESET 4").await), Reason::StaleToken);
    assert_eq!(refused(&ask(&stage, "d", token, "OPEN").await), Reason::NotImplemented);
    assert!(hardware.puts("commandstring").is_empty());
    accepted(&ask(&stage, "e", token, "RESET 4").await);
    assert_eq!(ended(&stage, "e").await, (CommandOutcome::Done, Some("axis|4,axis|2".to_owned())));

    let commander = Commander::start(&stage, "dome", token.unwrap()).await;
    let began = std::time::Instant::now();
    while let Reply::Refusal(refusal) = ask(&stage, &format!("f{:?}", began.elapsed()), token, "STATUS").await {
        assert_eq!(refusal.reason, Reason::NoPermit);
        assert!(began.elapsed() < test_support::LIMIT, "{refusal}");
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    }
    assert_eq!(refused(&ask(&stage, "g", token, "OPEN").await), Reason::NotImplemented);
    drop(commander);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_device_refuses_or_answers_at_too_great_length_has_failed() {
    let hardware = a_dome().await;
    let stage = Stage::start(&block("dome", "dome", &hardware, LISTED)).await;
    stage.until::<Dome>("dome", |state| state.link == contract::Link::Connected).await;
    let token = accepted(&stage.command(Kind::Dome, "dome", &command("c", None, dome::Command::Claim)).await);
    for (id, answer, word) in [
        ("a", FakeAnswer::Error(0x40B, "axis in error"), "axis in error"),
        ("b", FakeAnswer::Value(json!("x".repeat(20_000))), "20000 bytes"),
    ] {
        hardware.answer("put commandstring", answer);
        accepted(&ask(&stage, id, token, "RESET 1").await);
        let (outcome, answer) = ended(&stage, id).await;
        assert!(matches!(&outcome, CommandOutcome::Failed { reason } if reason.contains(word)), "{outcome:?}");
        assert_eq!(answer, None);
    }
    assert_eq!(hardware.puts("commandstring").len(), 2, "never sent twice");
    stage.end().await;
}
