//! Rates for moving targets: taken where the mount takes them, and ended by whatever comes next.

use contract::device::telescope::{Command, Telescope};
use contract::{Kind, Reason};
use serde_json::{Value, json};

use crate::block;
use crate::fake::{Fake, FakeAnswer};
use crate::stage::{Stage, accepted, command, refused};

/// A mount in the open that does at once what it is ordered.
pub async fn a_mount(takes_rates: bool) -> Fake {
    let mount = Fake::start(&[
        ("rightascension", json!(3.0)),
        ("declination", json!(-20.0)),
        ("altitude", json!(60.0)),
        ("azimuth", json!(120.0)),
        ("tracking", json!(true)),
        ("slewing", json!(false)),
        ("atpark", json!(false)),
        ("sideofpier", json!(0)),
        ("ispulseguiding", json!(false)),
        ("canpark", json!(true)),
        ("canslewasync", json!(true)),
        ("cansettracking", json!(true)),
        ("cansetrightascensionrate", json!(takes_rates)),
        ("cansetdeclinationrate", json!(takes_rates)),
        ("equatorialsystem", json!(2)),
        // Rates that another program left behind before this node began.
        ("rightascensionrate", json!(0.5)),
        ("declinationrate", json!(-3.0)),
    ])
    .await;
    let keep = |method: &'static str, field: &'static str| {
        mount.on(method, move |mount, form| {
            let text = form.split('&').find_map(|pair| pair.strip_prefix(field)?.strip_prefix('=')).unwrap();
            let value: Value = serde_json::from_str(&text.to_lowercase()).unwrap();
            mount.answer(method, FakeAnswer::Value(value));
        });
    };
    keep("rightascensionrate", "RightAscensionRate");
    keep("declinationrate", "DeclinationRate");
    keep("tracking", "Tracking");
    mount.on("park", |mount, _| {
        mount.answer("atpark", FakeAnswer::Value(json!(true)));
        mount.answer("tracking", FakeAnswer::Value(json!(false)));
    });
    mount.on("slewtocoordinatesasync", |_, _| {});
    mount
}

pub async fn ready(stage: &Stage) -> Option<u64> {
    stage.until::<Telescope>("mount", |state| state.fields.tracking.known() == Some(&true)).await;
    accepted(&stage.command(Kind::Telescope, "mount", &command("claim", None, Command::Claim)).await)
}

#[tokio::test(flavor = "multi_thread")]
async fn rates_end_with_a_slew_with_tracking_and_with_a_park() {
    let mount = a_mount(true).await;
    let stage = Stage::start(&block(
        "telescope",
        "mount",
        &mount,
        "period_s = 0.2\nsettle_s = 0.0\nlimits = { altitude_min_deg = -90.0 }",
    ))
    .await;
    let token = ready(&stage).await;
    let slew = || Command::Slew { ra_deg: 45.0, dec_deg: -20.0 };
    let moon = || Command::Rates { ra_s_per_sidereal_s: 0.0367, dec_arcsec_per_s: -0.125 };
    let steps = [
        slew(),
        moon(),
        slew(),
        slew(),
        moon(),
        Command::Track { on: false },
        Command::Track { on: true },
        moon(),
        Command::Park,
    ];
    // PUTs of rates so far: those of before are ended once, each slew after rates, and nothing without a reason.
    let expected = [1, 2, 3, 3, 4, 5, 5, 6, 7];
    for (number, (action, puts)) in steps.into_iter().zip(expected).enumerate() {
        let asked = command(&format!("d{number}"), token, action);
        accepted(&stage.command(Kind::Telescope, "mount", &asked).await);
        stage.until::<Telescope>("mount", |state| state.has_done(&asked.id)).await;
        let counted = [mount.puts("rightascensionrate").len(), mount.puts("declinationrate").len()];
        assert_eq!(counted, [puts, puts], "after {:?}", asked.action);
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rates_are_refused_by_a_mount_that_takes_none_or_does_not_track_and_where_they_are_no_rates() {
    let (mount, fixed) = (a_mount(true).await, a_mount(false).await);
    let rates = |ra: f64| Command::Rates { ra_s_per_sidereal_s: ra, dec_arcsec_per_s: 0.0 };
    let stage =
        Stage::start(&block("telescope", "mount", &fixed, "period_s = 0.2\nlimits = { altitude_min_deg = -90.0 }"))
            .await;
    let token = ready(&stage).await;
    let reply = stage.command(Kind::Telescope, "mount", &command("r", token, rates(0.1))).await;
    assert_eq!(refused(&reply), Reason::NotImplemented);
    assert!(fixed.puts("rightascensionrate").is_empty());
    stage.end().await;

    let stage =
        Stage::start(&block("telescope", "mount", &mount, "period_s = 0.2\nlimits = { altitude_min_deg = -90.0 }"))
            .await;
    let token = ready(&stage).await;
    let reply = stage.command(Kind::Telescope, "mount", &command("r1", token, rates(1e9))).await;
    assert_eq!(refused(&reply), Reason::Malformed);
    mount.answer("tracking", FakeAnswer::Value(json!(false)));
    stage.until::<Telescope>("mount", |state| state.fields.tracking.known() == Some(&false)).await;
    let reply = stage.command(Kind::Telescope, "mount", &command("r2", token, rates(0.1))).await;
    assert_eq!(refused(&reply), Reason::WrongState);
    // To follow the stars is no motion of its own.
    accepted(&stage.command(Kind::Telescope, "mount", &command("r3", token, rates(0.0))).await);
    stage.end().await;
}
