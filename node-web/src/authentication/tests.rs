//! What ends with time, by a clock that the test sets.

use std::time::Duration;

use axum::Router;
use axum::routing::{get, post};
use local_http::{Limits, Room};
use tokio::net::TcpListener;
use users::{FileFault, PasswordHash, User};

use super::*;
use crate::routes::login;

const LIMITS: Limits = Limits {
    room: Room { total: 50, per_address: 50, trusted: 0 },
    header: Duration::from_secs(10),
    total: Duration::from_secs(100),
};

/// A server whose clock stands still unless the test moves it.
struct Stage {
    _folder: tempfile::TempDir,
    now: Arc<Mutex<(MachineTime, Utc)>>,
    url: String,
    http: reqwest::Client,
    token: String,
}

impl Stage {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let utc: Utc = "2026-11-25T00:00:00Z".parse().unwrap();
        let web = Web { users: folder.path().join("users.toml"), ..Web::default() };
        let token = users::edit(&web.users, |users| {
            let name: Name = "ana".parse().unwrap();
            let password = PasswordHash::of_new("four plain words here", "ana").unwrap();
            users.users.insert(name.clone(), User { password, grants: vec![Grant::everywhere(Right::Viewer)] });
            let day = utc.plus(Duration::from_secs(86_400));
            Ok::<_, FileFault>(users.add_token("cron".parse().unwrap(), name, None, utc, day).unwrap())
        });
        let now = Arc::new(Mutex::new((MachineTime::from_boot(Duration::from_secs(1000)), utc)));
        let clock = now.clone();
        let authentication = Authentication::with_clock(&web, Box::new(move || *clock.lock().unwrap())).unwrap();
        let router = Router::new()
            .route("/api/v1/login", post(login::log_in))
            .route("/api/v1/me", get(login::me))
            .route("/api/v1/ws-ticket", post(login::ws_ticket))
            .route("/api/v1/ws", get(login::me))
            .layer(axum::middleware::from_fn_with_state(authentication, authenticate));
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/api/v1", listener.local_addr().unwrap());
        tokio::spawn(local_http::serve(listener, router, LIMITS, std::future::pending()));
        let http = local_http::client().unwrap();
        Self { _folder: folder, now, url, http, token: format!("Bearer {}", token.unwrap().reveal()) }
    }

    fn pass(&self, s: u64) {
        let mut now = self.now.lock().unwrap();
        let by = Duration::from_secs(s);
        *now = (now.0.plus(by), now.1.plus(by));
    }

    /// The cookie of a new session.
    async fn log_in(&self) -> String {
        let body = r#"{"name": "ana", "password": "four plain words here"}"#;
        let ask = self.http.post(format!("{}/login", self.url)).header("content-type", "application/json").body(body);
        let answer = ask.send().await.unwrap();
        let cookie = answer.headers()["set-cookie"].to_str().unwrap();
        cookie.split(';').next().unwrap().to_owned()
    }

    async fn status(&self, path: &str, header: &'static str, value: &str) -> u16 {
        self.http.get(format!("{}/{path}", self.url)).header(header, value).send().await.unwrap().status().as_u16()
    }
}

const HOUR: u64 = 3600;

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_is_used_ends_after_twelve_hours_and_one_that_is_not_after_two() {
    let stage = Stage::start().await;
    let (used, unused) = (stage.log_in().await, stage.log_in().await);
    for hour in 1..12 {
        stage.pass(HOUR);
        assert_eq!(stage.status("me", "cookie", &used).await, 200, "{hour}");
    }
    assert_eq!(stage.status("me", "cookie", &unused).await, 401);
    stage.pass(HOUR);
    assert_eq!(stage.status("me", "cookie", &used).await, 401);
    let again = stage.log_in().await;
    assert_eq!(stage.status("me", "cookie", &again).await, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_ends_at_its_time_and_a_ticket_after_thirty_seconds() {
    let stage = Stage::start().await;
    let ticket = async || {
        let ask = stage.http.post(format!("{}/ws-ticket", stage.url)).header("authorization", &stage.token);
        let answer: serde_json::Value =
            serde_json::from_slice(&ask.send().await.unwrap().bytes().await.unwrap()).unwrap();
        format!("ws?ticket={}", answer["ticket"].as_str().unwrap())
    };
    let (one, two) = (ticket().await, ticket().await);
    stage.pass(29);
    assert_eq!(stage.status(&one, "accept", "*/*").await, 200);
    stage.pass(1);
    assert_eq!(stage.status(&two, "accept", "*/*").await, 401);
    stage.pass(86_400 - 31);
    assert_eq!(stage.status("me", "authorization", &stage.token).await, 200);
    let last = ticket().await;
    stage.pass(1);
    assert_eq!(stage.status("me", "authorization", &stage.token).await, 401);
    assert_eq!(stage.status(&last, "accept", "*/*").await, 401, "a ticket is worth what it was made with");
}
