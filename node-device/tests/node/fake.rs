//! A small Alpaca server over real HTTP, whose every answer a test decides.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::any;
use serde_json::{Value, json};

/// What a member answers.
#[derive(Debug, Clone)]
pub enum FakeAnswer {
    Value(Value),
    Error(u32, &'static str),
    Hangs,
}

/// A method call that arrived.
#[derive(Debug, Clone)]
pub struct Put {
    pub member: String,
    pub at: Instant,
    pub form: String,
}

type Effect = Box<dyn Fn(&Fake, &str) + Send>;

#[derive(Default)]
struct World {
    answers: BTreeMap<String, FakeAnswer>,
    puts: Vec<Put>,
    effects: BTreeMap<String, Effect>,
    /// So many questions hang yet.
    gets_hang: u64,
    gets_take: Duration,
    /// Where it answers one request at a time.
    one_at_a_time: Option<Arc<tokio::sync::Mutex<()>>>,
    /// `None`: no exposure; else when it began and how long it takes.
    exposure: Option<(Instant, Duration)>,
    exposure_ends: Vec<Instant>,
}

/// The server; clones are the same one.
#[derive(Clone)]
pub struct Fake {
    world: Arc<Mutex<World>>,
    /// Requests that hang now.
    hanging: Arc<AtomicUsize>,
    pub address: SocketAddr,
}

/// A request that hangs until its client gives it up.
struct Hanging(Arc<AtomicUsize>);

impl Hanging {
    fn on(fake: &Fake) -> Self {
        fake.hanging.fetch_add(1, Ordering::SeqCst);
        Self(fake.hanging.clone())
    }
}

impl Drop for Hanging {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Fake {
    pub async fn start(answers: &[(&str, Value)]) -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let fake = Self { world: Arc::default(), hanging: Arc::default(), address: listener.local_addr().unwrap() };
        for (member, value) in answers {
            fake.answer(member, FakeAnswer::Value(value.clone()));
        }
        let router = Router::new().route("/api/v1/{kind}/{number}/{member}", any(answer)).with_state(fake.clone());
        tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
        fake
    }

    /// A member answers this from now on.
    pub fn answer(&self, member: &str, answer: FakeAnswer) {
        self.world.lock().unwrap().answers.insert(member.to_owned(), answer);
    }

    /// A member is unknown from now on: HTTP 400.
    pub fn deny(&self, member: &str) {
        self.world.lock().unwrap().answers.remove(member);
    }

    /// A method does this from now on; it gets the form of the call.
    pub fn on(&self, method: &str, effect: impl Fn(&Self, &str) + Send + 'static) {
        self.world.lock().unwrap().effects.insert(method.to_owned(), Box::new(effect));
    }

    /// Every property hangs, or none.
    pub fn hang(&self, on: bool) {
        self.hang_next(if on { u64::MAX } else { 0 });
    }

    /// So many questions hang, and those after them are answered.
    pub fn hang_next(&self, count: u64) {
        self.world.lock().unwrap().gets_hang = count;
    }

    fn takes_to_hang(&self) -> bool {
        let mut world = self.world.lock().unwrap();
        let hangs = world.gets_hang > 0;
        world.gets_hang = world.gets_hang.saturating_sub(1);
        hangs
    }

    /// Requests that hang now, and whose clients wait.
    pub fn hanging(&self) -> usize {
        self.hanging.load(Ordering::SeqCst)
    }

    /// Every property takes so long, several at a time or one after another.
    pub fn slow(&self, takes: Duration, one_at_a_time: bool) {
        let mut world = self.world.lock().unwrap();
        (world.gets_take, world.one_at_a_time) = (takes, one_at_a_time.then(Arc::default));
    }

    /// Calls of a method so far.
    pub fn puts(&self, member: &str) -> Vec<Put> {
        self.world.lock().unwrap().puts.iter().filter(|put| put.member == member).cloned().collect()
    }

    /// When each exposure was over.
    pub fn exposure_ends(&self) -> Vec<Instant> {
        self.world.lock().unwrap().exposure_ends.clone()
    }

    /// Makes it a camera of 3 x 2 pixels that exposes and hands images over.
    pub fn be_a_camera(&self) {
        self.on("startexposure", |fake, form| {
            let duration = form.split('&').find_map(|pair| pair.strip_prefix("Duration=")).unwrap();
            let duration = Duration::from_secs_f64(duration.parse().unwrap());
            let mut world = fake.world.lock().unwrap();
            world.exposure = Some((Instant::now(), duration));
            world.exposure_ends.push(Instant::now() + duration);
        });
        self.on("abortexposure", |fake, _| fake.world.lock().unwrap().exposure = None);
    }

    fn camera(&self, member: &str) -> Option<Response> {
        let world = self.world.lock().unwrap();
        // What a test answers in its place.
        if !world.effects.contains_key("startexposure") || world.answers.contains_key(member) {
            return None;
        }
        let ready = world.exposure.is_some_and(|(began, takes)| began.elapsed() >= takes);
        match member {
            "imageready" => Some(value(json!(ready))),
            "camerastate" => Some(value(json!(if world.exposure.is_some() && !ready { 2 } else { 0 }))),
            "imagearray" => {
                let mut body: Vec<u8> =
                    [1_i32, 0, 0, 1, 44, 2, 8, 2, 3, 2, 0].into_iter().flat_map(i32::to_le_bytes).collect();
                body.extend((1_u16..=6).flat_map(u16::to_le_bytes));
                Some(([(header::CONTENT_TYPE, "application/imagebytes")], body).into_response())
            }
            _ => None,
        }
    }
}

fn value(value: Value) -> Response {
    axum::Json(json!({"Value": value, "ErrorNumber": 0, "ErrorMessage": ""})).into_response()
}

async fn answer(
    State(fake): State<Fake>,
    Path((_, _, member)): Path<(String, String, String)>,
    method: Method,
    _: HeaderMap,
    body: Bytes,
) -> Response {
    if method == Method::GET {
        let (takes, turns) = {
            let world = fake.world.lock().unwrap();
            (world.gets_take, world.one_at_a_time.clone())
        };
        let _turn = match &turns {
            Some(turns) => Some(turns.lock().await),
            None => None,
        };
        tokio::time::sleep(takes).await;
    }
    let answer = if method == Method::PUT {
        let form = String::from_utf8_lossy(&body).into_owned();
        let put = Put { member: member.clone(), at: Instant::now(), form: form.clone() };
        fake.world.lock().unwrap().puts.push(put);
        let effect = fake.world.lock().unwrap().effects.remove(&member);
        if let Some(effect) = effect {
            effect(&fake, &form);
            fake.world.lock().unwrap().effects.insert(member.clone(), effect);
        }
        fake.world
            .lock()
            .unwrap()
            .answers
            .get(&format!("put {member}"))
            .cloned()
            .or(Some(FakeAnswer::Value(Value::Null)))
    } else if fake.takes_to_hang() {
        Some(FakeAnswer::Hangs)
    } else if let Some(image) = fake.camera(&member) {
        return image;
    } else {
        fake.world.lock().unwrap().answers.get(&member).cloned()
    };
    match answer {
        Some(FakeAnswer::Value(answer)) => value(answer),
        Some(FakeAnswer::Error(number, message)) => {
            axum::Json(json!({"ErrorNumber": number, "ErrorMessage": message})).into_response()
        }
        Some(FakeAnswer::Hangs) => {
            let _hanging = Hanging::on(&fake);
            std::future::pending().await
        }
        None => (StatusCode::BAD_REQUEST, "no such member").into_response(),
    }
}
