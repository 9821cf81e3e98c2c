//! Drafts of schedules: stored, compared, checked and put in force, and nobody's change is overwritten unseen.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use contract::observatory::{
    ActionAnswer, ActionQuestion, NightState, RowStatus, ScheduleDraft, ScheduleFindings, SchedulePlan,
    SchedulePlanQuestion, ScheduleState, ScheduleTextQuestion, ScheduleTexts,
};
use contract::{Accepted, Key, Order, OrderKind, Part, Reason, Refusal, Reply};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use test_support::LIMIT;

use crate::stage::raw::{Answer, add_user, exchange, request, with_users};
use crate::stage::{Published, Stage, address, sample};

const SCHEDULE: &str = "/api/v1/telescopes/paranal/callisto/schedule";
const JSONL: &str = "Accept: application/jsonl\r\n";

fn sha256(text: &str) -> String {
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn row(object: &str, exptime: u32) -> String {
    format!(
        "{{\"device_name\": \"cam\", \"action_type\": \"object\", \"action_value\": {{\"object\": \"{object}\", \"exptime\": {exptime}}}, \
         \"start_time\": \"2026-11-21 03:00:00\", \"end_time\": \"2026-11-21 04:00:00\"}}\n"
    )
}

/// An observatory node whose schedule in force is a text; a text with "objekt" is none.
struct Observatory {
    text: Arc<Mutex<String>>,
    orders: Arc<Mutex<Vec<Order>>>,
    plans: Arc<AtomicU32>,
    _services: Vec<bus::Service>,
    _night: Published<NightState>,
    state: ScheduleState,
    schedule: Published<ScheduleState>,
}

impl Observatory {
    async fn start(stage: &Stage) -> Self {
        let (text, orders) = (Arc::new(Mutex::new(row("old", 10))), Arc::<Mutex<Vec<Order>>>::default());
        let (at, (now, taken)) = (address("callisto"), (text.clone(), orders.clone()));
        let order = move |order: Result<Order, String>| {
            let order = order.unwrap();
            let OrderKind::PutSchedule { text: new, instead_of } = &order.kind else { panic!("{order:?}") };
            let mut now = now.lock().unwrap();
            let known = taken.lock().unwrap().iter().any(|known| known.id == order.id);
            let refusal = |reason, detail: &str| {
                Reply::Refusal(Refusal { id: order.id.clone(), reason, detail: detail.to_owned() })
            };
            let reply = match instead_of {
                _ if known => Reply::Accepted(Accepted { id: order.id.clone(), token: None, not_written: None }),
                Some(wanted) if *wanted != sha256(&now) => refusal(Reason::WrongState, "another schedule is in force"),
                _ => {
                    now.clone_from(new);
                    taken.lock().unwrap().push(order.clone());
                    Reply::Accepted(Accepted { id: order.id.clone(), token: None, not_written: None })
                }
            };
            async move { reply }
        };
        let now = text.clone();
        let texts = move |asked: Result<ScheduleTextQuestion, String>| {
            let asked = asked.unwrap();
            let text = now.lock().unwrap().clone();
            let version = json!({"version": 3, "at_utc": "2026-11-21T03:00:00Z", "author": "file", "rows": 1, "bytes": 9, "sha256": sha256(&text)});
            let answer = match (asked.list, asked.version) {
                (Some(_), _) => json!({"versions": [version]}),
                (None, None | Some(3)) => json!({"text": text, "sha256": sha256(&text), "versions": [version]}),
                _ => json!({}),
            };
            async move { serde_json::from_value::<ScheduleTexts>(answer).unwrap() }
        };
        let check = |draft: Result<ScheduleDraft, String>| async move {
            let valid = !draft.unwrap().text.contains("objekt");
            let finding = json!({"severity": "error", "check": "schema", "line": 1, "column": 5, "field": "action_type", "what": "unknown action_type \"objekt\""});
            let findings = if valid { json!([]) } else { json!([finding]) };
            let answer =
                json!({"valid": valid, "rows": 1, "errors": u32::from(!valid), "warnings": 0, "findings": findings});
            serde_json::from_value::<ScheduleFindings>(answer).unwrap()
        };
        let plans = Arc::<AtomicU32>::default();
        let made = plans.clone();
        let plan = move |asked: Result<SchedulePlanQuestion, String>| {
            made.fetch_add(1, Ordering::Relaxed);
            async move {
                let asked = asked.unwrap();
                let mut plan: SchedulePlan = serde_json::from_value(sample("schedule.plan")).unwrap();
                let begun = asked.begun.map(|begun| format!(", {} rows have begun", begun.rows.len()));
                plan.problem = Some(format!("{} spans{}", asked.unsafe_utc.len(), begun.unwrap_or_default()));
                plan
            }
        };
        let actions = |asked: Result<ActionQuestion, String>| async move {
            let mut answer: ActionAnswer = serde_json::from_value(sample("actions.answer")).unwrap();
            answer
                .actions
                .retain(|action| asked.as_ref().unwrap().action.as_ref().is_none_or(|name| *name == action.name));
            answer
        };
        let services = vec![
            stage.bus.serve(&Key::Order(at.clone()), order).await.unwrap(),
            stage.bus.serve(&Key::ScheduleTexts(at.clone()), texts).await.unwrap(),
            stage.bus.serve(&Key::ScheduleCheck(at.clone()), check).await.unwrap(),
            stage.bus.serve(&Key::SchedulePlan(at.clone()), plan).await.unwrap(),
            stage.bus.serve(&Key::Actions(at.clone()), actions).await.unwrap(),
        ];
        let night: NightState = serde_json::from_value(sample("observatory.night")).unwrap();
        let night = stage.publish(Key::Observatory(at.clone(), Part::Night), night).await;
        let mut state: ScheduleState = serde_json::from_value(sample("observatory.schedule")).unwrap();
        state.sha256 = Some(sha256(&text.lock().unwrap()));
        let schedule = stage.publish(Key::Observatory(at, Part::Schedule), state.clone()).await;
        Self { text, orders, plans, _services: services, _night: night, state, schedule }
    }
}

/// Asks with a text as the body until the observatory node is known to this one.
async fn send(stage: &Stage, ask: &str, headers: &str, text: &str) -> Answer {
    let head = format!("Content-Type: application/jsonl\r\nContent-Length: {}\r\n{headers}", text.len());
    let message = request(stage.authority(), ask, &head, None) + text;
    let answered = async {
        loop {
            let answer = exchange(stage.connect_from("127.0.0.1").await.unwrap(), &message).await;
            if answer.status != 504 {
                return answer;
            }
            tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(LIMIT, answered).await.unwrap_or_else(|_| panic!("{ask}: nobody answers"))
}

async fn get(stage: &Stage, path: &str, headers: &str) -> Answer {
    send(stage, &format!("GET {SCHEDULE}{path}"), headers, "").await
}

async fn until_known(stage: &Stage) {
    stage.until(SCHEDULE, |schedule| schedule["body"]["sha256"].is_string()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_draft_is_stored_compared_checked_forecast_and_put_in_force() {
    let folder = with_users();
    add_user(folder.path(), "olga", &["observer:paranal/*"]);
    let stage = Stage::start_with("requests_per_s = 1000\n", folder.path()).await;
    let observatory = Observatory::start(&stage).await;
    let (ana, olga) = (stage.session("ana").await, stage.session("olga").await);
    let ready = async { while get(&stage, "", &ana).await.json()["body"]["sha256"].is_null() {} };
    tokio::time::timeout(LIMIT, ready).await.unwrap();

    // Comments and blanks are stored byte for byte.
    let text = format!("// tonight\n{}   {}", row("old", 20), row("new", 5));
    let draft = format!("PUT {SCHEDULE}/drafts/tonight");
    let new = format!("{olga}If-None-Match: *\r\n");
    let made = send(&stage, &draft, &new, &text).await;
    assert_eq!((made.status, &made.json()["author"]), (201, &json!("olga")), "{}", made.text);
    assert_eq!(made.json()["based_on"], sha256(&row("old", 10)));
    let read = get(&stage, "/drafts/tonight", &format!("{olga}{JSONL}")).await;
    assert_eq!((read.status, read.text.as_str(), read.header("etag")), (200, text.as_str(), made.header("etag")));
    let known = format!("{olga}{JSONL}If-None-Match: {}\r\n", made.header("etag").unwrap());
    assert_eq!(get(&stage, "/drafts/tonight", &known).await.status, 304);
    let list = get(&stage, "/drafts", &olga).await.json();
    assert_eq!(
        (list.as_array().unwrap().len(), &list[0]["id"], &list[0]["bytes"]),
        (1, &json!("tonight"), &json!(text.len()))
    );

    let diff = get(&stage, "/drafts/tonight/diff", &olga).await.json();
    let changes: Vec<(&str, &Value)> = diff["changes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| (row["change"].as_str().unwrap(), &row["line_after"]))
        .collect();
    assert_eq!(changes, [("changed", &json!(2)), ("added", &json!(3))], "{diff}");
    assert_eq!(diff["changes"][0]["fields"], json!([{"pointer": "/action_value/exptime", "before": 10, "after": 20}]));
    assert_eq!(diff["in_force_sha256"], sha256(&row("old", 10)));

    let findings =
        send(&stage, &format!("POST {SCHEDULE}/validate"), &olga, &row("x", 1).replace("\"object\"", "\"objekt\""))
            .await;
    assert_eq!((findings.status, &findings.json()["findings"][0]["line"]), (200, &json!(1)), "{}", findings.text);
    let spans = "?unsafe=2026-11-21T03:00:00Z..2026-11-21T04:00:00Z,2026-11-21T05:00:00Z..2026-11-21T06:00:00Z";
    let plan = send(&stage, &format!("POST {SCHEDULE}/simulate{spans}"), &olga, &text).await;
    assert_eq!(
        (plan.status, &plan.json()["problem"], &plan.json()["rows"][0]["frames"]),
        (200, &json!("2 spans"), &json!(400))
    );
    let wrong = send(&stage, &format!("POST {SCHEDULE}/simulate?unsafe=tonight"), &olga, &text).await;
    assert!(wrong.status == 400 && wrong.text.contains("expected FROM..TO"), "{}", wrong.text);

    let in_force = get(&stage, "", &format!("{olga}{JSONL}")).await;
    assert_eq!(in_force.text, row("old", 10));
    assert_eq!(in_force.header("etag").unwrap(), format!("\"{}\"", sha256(&row("old", 10))));
    let activate = async |headers: &str, draft: &str, body: Value| {
        let ask = format!("POST {SCHEDULE}/drafts/{draft}/activate");
        stage.ask(&ask, headers, Some(&body)).await
    };
    let demand = format!("{ana}If-Match: {}\r\nIdempotency-Key: k1\r\n", in_force.header("etag").unwrap());
    let why = json!({"reason": "the supernova"});
    assert_eq!(
        activate(&demand.replace(&ana, &olga), "tonight", why.clone()).await.status,
        403,
        "an observer only writes it"
    );
    let done = activate(&demand, "tonight", why.clone()).await;
    assert_eq!(
        (done.status, &done.json()["state"], &done.json()["reason"]),
        (202, &json!("done"), &json!("the supernova")),
        "{}",
        done.text
    );
    assert_eq!(*observatory.text.lock().unwrap(), text, "byte for byte");
    let again = activate(&demand, "tonight", why.clone()).await;
    assert_eq!((again.status, again.json()), (202, done.json()), "the same request again is the same command");
    assert_eq!(observatory.orders.lock().unwrap().len(), 1);
    assert!(observatory.orders.lock().unwrap()[0].from.starts_with("web/ana@"));

    let list = get(&stage, "/revisions?limit=5", &olga).await;
    assert_eq!((list.status, &list.json()[0]["version"]), (200, &json!(3)), "{}", list.text);
    let one = get(&stage, "/revisions/3", &olga).await.json();
    assert_eq!((&one["author"], &one["text"]), (&json!("file"), &json!(text)));
    for (path, status) in [("/revisions/4", 404), ("/revisions/x", 404), ("/revisions?limit=0", 400)] {
        assert_eq!(get(&stage, path, &olga).await.status, status, "{path}");
    }
    let actions = get(&stage, "/action-schemas", &olga).await.json();
    assert!(actions[0]["schema"]["properties"].is_object(), "{actions}");
    assert_eq!(get(&stage, "/action-schemas?action=nothing", &olga).await.status, 404);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_who_edit_one_draft_the_second_is_asked_to_look_again() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::start_with("", folder.path()).await;
    let _observatory = Observatory::start(&stage).await;
    until_known(&stage).await;
    let put = async |headers: &str, text: &str| send(&stage, &format!("PUT {SCHEDULE}/drafts/a"), headers, text).await;
    assert_eq!(put("", &row("x", 1)).await.status, 428);
    let none = put("If-Match: \"0\"\r\n", &row("x", 1)).await;
    assert_eq!((none.status, &none.json()["code"]), (412, &json!("precondition")), "{}", none.text);
    let first = put("If-None-Match: *\r\n", &row("x", 1)).await;
    assert_eq!(first.status, 201, "{}", first.text);
    let tag = first.header("etag").unwrap().to_owned();
    assert_eq!(put("If-None-Match: *\r\n", &row("x", 2)).await.status, 412, "it is there");
    let mine = format!("If-Match: {tag}\r\n");
    let (one, other) = tokio::join!(put(&mine, "one"), put(&mine, "other"));
    let mut both = [(one.status, "one"), (other.status, "other")];
    both.sort_unstable();
    let [(200, winner), (412, _)] = both else { panic!("{both:?}") };
    let now = get(&stage, "/drafts/a", JSONL).await;
    assert_eq!(now.text, winner);
    // The answer of the one who was too late has the tag of what is there.
    let late = if one.status == 412 { one } else { other };
    assert_eq!(late.header("etag"), now.header("etag"));
    for (headers, status) in [("", 428), (mine.as_str(), 412), ("If-Match: *\r\n", 204), ("If-Match: *\r\n", 404)] {
        assert_eq!(send(&stage, &format!("DELETE {SCHEDULE}/drafts/a"), headers, "").await.status, status, "{headers}");
    }
    // Rows as JSON are a draft, too, a row a line.
    let rows = json!([{"device_name": "cam", "action_type": "close"}, {"b": 1, "a": 2}]);
    let ask = format!("PUT {SCHEDULE}/drafts/json");
    assert_eq!(stage.ask(&ask, "If-None-Match: *\r\n", Some(&rows)).await.status, 201);
    let text = get(&stage, "/drafts/json", JSONL).await.text;
    assert_eq!(text, "{\"device_name\":\"cam\",\"action_type\":\"close\"}\n{\"b\":1,\"a\":2}\n");
    // A restart of the node forgets none, and its files are for its user alone.
    stage.end().await;
    let stage = Stage::start_with("", folder.path()).await;
    let _observatory = Observatory::start(&stage).await;
    until_known(&stage).await;
    assert_eq!(get(&stage, "/drafts/json", JSONL).await.text, text);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let file = folder.path().join("data/drafts-callisto/paranal/callisto/json.json");
        assert_eq!(std::fs::metadata(file).unwrap().permissions().mode() & 0o777, 0o600);
    }
    for (path, text, status) in
        [("a%20b", "x".to_owned(), 404), ("..%2fx", "x".to_owned(), 404), ("large", "x".repeat(1_000_001), 413)]
    {
        let answer = send(&stage, &format!("PUT {SCHEDULE}/drafts/{path}"), "If-None-Match: *\r\n", &text).await;
        assert_eq!(answer.status, status, "{path}: {}", answer.text);
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_schedule_that_somebody_else_put_meanwhile_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::start_with("", folder.path()).await;
    let observatory = Observatory::start(&stage).await;
    until_known(&stage).await;
    let seen = get(&stage, "", JSONL).await.header("etag").unwrap().to_owned();
    for (id, text) in [("good", row("new", 5)), ("bad", row("x", 1).replace("\"object\"", "\"objekt\""))] {
        let made = send(&stage, &format!("PUT {SCHEDULE}/drafts/{id}"), "If-None-Match: *\r\n", &text).await;
        assert_eq!(made.status, 201, "{}", made.text);
    }
    let activate = async |id: &str, headers: &str| {
        let body = json!({"reason": "why", "operator": "ana"});
        stage.ask(&format!("POST {SCHEDULE}/drafts/{id}/activate"), headers, Some(&body)).await
    };
    let with = |tag: &str, key: &str| format!("If-Match: {tag}\r\nIdempotency-Key: {key}\r\n");
    let bad = activate("bad", &with(&seen, "1")).await;
    assert_eq!((bad.status, &bad.json()["errors"][0]["line"]), (422, &json!(1)), "{}", bad.text);
    assert_eq!(activate("good", "Idempotency-Key: 2\r\n").await.status, 428);
    assert_eq!(activate("good", &format!("If-Match: {seen}\r\n")).await.status, 400, "no key");
    assert_eq!(activate("good", &with("\"a\", \"b\"", "3")).await.status, 400);
    assert_eq!(activate("none", &with(&seen, "4")).await.status, 404);
    *observatory.text.lock().unwrap() = row("of somebody else", 1);
    let late = activate("good", &with(&seen, "5")).await;
    assert_eq!((late.status, &late.json()["code"]), (412, &json!("precondition")), "{}", late.text);
    assert_eq!(*observatory.text.lock().unwrap(), row("of somebody else", 1));
    assert!(observatory.orders.lock().unwrap().is_empty());
    let now = get(&stage, "", JSONL).await.header("etag").unwrap().to_owned();
    assert_eq!(activate("good", &with(&now, "6")).await.json()["state"], "done");
    assert_eq!(activate("good", &with("*", "7")).await.json()["state"], "done", "whichever is in force");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_forecast_is_made_once_for_all_who_look_and_again_for_another_schedule() {
    let folder = with_users();
    add_user(folder.path(), "vera", &["viewer:paranal/*"]);
    let stage = Stage::start_with("requests_per_s = 1000\n", folder.path()).await;
    let observatory = Observatory::start(&stage).await;
    let vera = stage.session("vera").await;
    let ready = async { while get(&stage, "", &vera).await.json()["body"]["sha256"].is_null() {} };
    tokio::time::timeout(LIMIT, ready).await.unwrap();
    let path = SCHEDULE.replace("/schedule", "/forecast");
    let ask = async |headers: String| send(&stage, &format!("GET {path}"), &headers, "").await;
    let (one, other, third) = tokio::join!(ask(vera.clone()), ask(vera.clone()), ask(vera.clone()));
    assert_eq!((one.status, &one.json()["sha256"]), (200, &json!(sha256(&row("old", 10)))), "{}", one.text);
    assert!(one.json()["rows"][0]["frames"] == 400 && one.json()["made_utc"].is_string(), "{}", one.text);
    let have_begun = observatory.state.rows.iter().filter(|row| row.status != RowStatus::Pending).count();
    assert_eq!(one.json()["problem"], format!("0 spans, {have_begun} rows have begun"));
    assert_eq!((one.text.as_str(), one.header("etag")), (other.text.as_str(), third.header("etag")));
    assert_eq!(one.header("cache-control"), Some("private, no-cache"));
    let known = format!("{vera}If-None-Match: {}\r\n", one.header("etag").unwrap());
    let again = ask(known.clone()).await;
    assert_eq!((again.status, again.text.as_str(), again.header("etag")), (304, "", one.header("etag")));
    assert_eq!(observatory.plans.load(Ordering::Relaxed), 1, "a viewer's look makes none anew");

    let new = row("new", 5);
    observatory.text.lock().unwrap().clone_from(&new);
    let state = ScheduleState { sha256: Some(sha256(&new)), ..observatory.state.clone() };
    observatory.schedule.put(state);
    let ready = async { while ask(known.clone()).await.status == 304 {} };
    tokio::time::timeout(LIMIT, ready).await.unwrap();
    let next = ask(known).await;
    assert_eq!((next.status, &next.json()["sha256"]), (200, &json!(sha256(&new))), "{}", next.text);
    assert_eq!(observatory.plans.load(Ordering::Relaxed), 2);
    stage.end().await;
}
