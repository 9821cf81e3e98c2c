//! A plain Alpaca client for tests.

use std::time::Duration;

use serde_json::Value;
use simulator::{MountOptions, Options, Simulator};
use units::Angle;

/// A simulator and a client of it.
pub struct Site {
    pub simulator: Simulator,
    pub http: reqwest::Client,
}

/// A night over Paranal, a perfect mount, a small camera, so fast that nothing takes long.
pub fn options(speed: f64) -> Options {
    let mut options = Options { start: "2026-11-21T03:00:00Z".parse().unwrap(), speed, ..Options::default() };
    options.mount = MountOptions::perfect();
    options.latitude = Angle::from_degrees(-24.6272);
    (options.camera.width, options.camera.height) = (512, 400);
    options
}

impl Site {
    pub async fn start(options: Options) -> Self {
        let simulator = Simulator::start(options).await.unwrap();
        let http = reqwest::Client::builder().timeout(Duration::from_secs(20)).build().unwrap();
        Self { simulator, http }
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
        let response = request.header("Content-Type", "application/x-www-form-urlencoded").send().await.unwrap();
        let status = response.status().as_u16();
        let answer: Value = serde_json::from_str(&response.text().await.unwrap()).unwrap_or_default();
        (status, answer["ErrorNumber"].as_i64().unwrap_or(-1))
    }

    /// A PUT that must succeed.
    pub async fn put(&self, kind: &str, member: &str, form: &str) {
        assert_eq!(self.try_put(kind, member, form).await, (200, 0), "{kind} {member} {form}");
    }

    /// Waits until a property has a value, at most ten seconds.
    pub async fn until(&self, kind: &str, member: &str, expected: impl Into<Value>) {
        let expected = expected.into();
        let mut value = Value::Null;
        for _ in 0..1000 {
            value = self.get(kind, member).await;
            if value == expected {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
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
