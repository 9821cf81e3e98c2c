//! A plain Alpaca client for tests.

use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use simulator::{MountOptions, Options, Simulator, World};
use units::Angle;

/// What takes longer hangs, also on a busy machine.
pub const LIMIT: Duration = Duration::from_secs(120);
/// Methods that answer when the slew is done.
const WAITS: [&str; 3] = ["slewtocoordinates", "slewtotarget", "slewtoaltaz"];
/// So many looks at a property; each lets a twentieth of a second pass, times the speed.
const LOOKS: u32 = 1000;

/// A simulator and a client of it. Its clock stands: sky time passes while something is waited for, and not with the
/// time of this machine.
pub struct Site {
    pub simulator: Simulator,
    pub http: reqwest::Client,
    step_s: f64,
}

/// A night over Paranal, a perfect mount, a small camera; time passes in steps of a twentieth of the speed.
pub fn options(speed: f64) -> Options {
    let mut options = Options { start: "2026-11-21T03:00:00Z".parse().unwrap(), speed, ..Options::default() };
    options.mount = MountOptions::perfect();
    options.latitude = Angle::from_degrees(-24.6272);
    (options.camera.width, options.camera.height) = (512, 400);
    options
}

impl Site {
    pub async fn start(options: Options) -> Self {
        let step_s = options.speed / 20.0;
        let simulator = Simulator::start(options).await.unwrap();
        simulator.world().stop_clock();
        let http = reqwest::Client::builder().timeout(LIMIT).build().unwrap();
        Self { simulator, http, step_s }
    }

    /// Lets so many sky seconds pass.
    pub async fn pass(&self, sky_s: f64) {
        self.world().pass(sky_s).await;
    }

    /// The world behind the simulator.
    pub fn world(&self) -> &Arc<World> {
        self.simulator.world()
    }

    /// ... with these devices connected.
    pub async fn connected(options: Options, kinds: &[&str]) -> Self {
        let site = Self::start(options).await;
        for kind in kinds {
            site.put(kind, "connected", "Connected=true").await;
        }
        site
    }

    /// `kind` is `camera`, or `camera/1` for another than the first.
    pub fn url(&self, kind: &str, member: &str) -> String {
        let device = if kind.contains('/') { kind.to_owned() } else { format!("{kind}/0") };
        format!("http://{}/api/v1/{device}/{member}", self.simulator.address())
    }

    /// The whole answer to a GET; `member` may carry a query.
    pub async fn answer(&self, kind: &str, member: &str) -> Value {
        let response = self.http.get(self.url(kind, member)).send().await.unwrap();
        assert_eq!(response.status(), 200, "{kind} {member}");
        serde_json::from_str(&response.text().await.unwrap()).unwrap()
    }

    /// The value of a GET that must succeed.
    pub async fn get(&self, kind: &str, member: &str) -> Value {
        let answer = self.answer(kind, member).await;
        assert_eq!(answer["ErrorNumber"], 0, "{kind} {member}: {answer}");
        answer["Value"].clone()
    }

    /// HTTP status and error number of a PUT.
    pub async fn try_put(&self, kind: &str, member: &str, form: &str) -> (u16, i64) {
        let request = self.http.put(self.url(kind, member)).body(form.to_owned());
        let sending = request.header("Content-Type", "application/x-www-form-urlencoded").send();
        let mut sending = std::pin::pin!(sending);
        let response = loop {
            tokio::select! {
                response = &mut sending => break response.unwrap(),
                () = tokio::time::sleep(Duration::from_millis(1)), if WAITS.contains(&member) => {
                    if self.world().is_slewing() {
                        self.pass(self.step_s).await;
                    }
                }
            }
        };
        let status = response.status().as_u16();
        let answer: Value = serde_json::from_str(&response.text().await.unwrap()).unwrap_or_default();
        (status, answer["ErrorNumber"].as_i64().unwrap_or(-1))
    }

    /// A PUT that must succeed.
    pub async fn put(&self, kind: &str, member: &str, form: &str) {
        assert_eq!(self.try_put(kind, member, form).await, (200, 0), "{kind} {member} {form}");
    }

    /// Lets time pass until a property has a value.
    pub async fn until(&self, kind: &str, member: &str, expected: impl Into<Value>) {
        let expected = expected.into();
        let mut value = Value::Null;
        for _ in 0..LOOKS {
            value = self.get(kind, member).await;
            if value == expected {
                return;
            }
            self.pass(self.step_s).await;
        }
        panic!("{kind} {member} is {value}, not {expected}");
    }

    /// Something under `/simulator/v1/`.
    pub async fn control(&self, path: &str) -> Value {
        let url = format!("http://{}/simulator/v1/{path}", self.simulator.address());
        serde_json::from_str(&self.http.get(url).send().await.unwrap().text().await.unwrap()).unwrap()
    }

    /// Orders something under `/simulator/v1/`.
    pub async fn order(&self, path: &str, body: &str) -> u16 {
        let url = format!("http://{}/simulator/v1/{path}", self.simulator.address());
        self.http.put(url).body(body.to_owned()).send().await.unwrap().status().as_u16()
    }
}
