//! The question who asks: without users nobody is asked on this host; with users each request needs a proof.

use serde_json::{Value, json};
use units::Utc;

use crate::stage::Stage;
use crate::stage::raw::{PASSWORD, change, exchange, request, with_users};

const NETWORK: &str = "GET /api/v1/network";
const ME: &str = "GET /api/v1/me";

#[tokio::test(flavor = "multi_thread")]
async fn without_users_programs_of_this_host_are_asked_nothing_and_what_a_proxy_forwards_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::start_with("", folder.path()).await;
    assert_eq!(stage.status(NETWORK, "").await, 200);
    let me = stage.ask(ME, "", None).await.json();
    assert_eq!((&me["name"], &me["way"], &me["rights"]), (&json!("local"), &json!("open"), &json!(["engineer"])));
    assert_eq!(me["insecure_open"], false);
    for forwarded in ["X-Forwarded-For: 8.8.8.8", "Forwarded: for=8.8.8.8", "X-Real-IP: 8.8.8.8", "X-Forwarded-Host: a"]
    {
        let answer = stage.ask(NETWORK, &format!("{forwarded}\r\n"), None).await;
        assert_eq!(answer.status, 403, "{forwarded}");
        assert!(answer.text.contains("starmesh user add"), "{}", answer.text);
    }
    let answer = stage.log_in_as("ana", PASSWORD, "127.0.0.1").await;
    assert_eq!((answer.status, &answer.json()["code"]), (409, &json!("conflict")), "{}", answer.text);
    assert_eq!(stage.ask("POST /api/v1/tokens", "", Some(&json!({"name": "a", "days": 1}))).await.status, 404);
    assert!(stage.ask("GET /", "", None).await.text.contains("app.js"));
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn with_users_everybody_is_asked_and_each_proof_opens_what_it_should() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    for ask in [
        NETWORK,
        ME,
        "GET /api/v1/telescopes/paranal/callisto",
        "GET /api/v1/ws",
        "GET /api/v1/sessions",
        "GET /api/v1/tokens",
        "GET /assets/app.js",
        "GET /nothing",
        "POST /api/v1/logout",
        "POST /api/v1/ws-ticket",
        "DELETE /api/v1/sessions/1",
        "POST /api/v1/tokens",
        "DELETE /api/v1/tokens/x",
        "PUT /api/v1/login",
        "GET /api/v1/login",
        "POST /",
        "OPTIONS /api/v1/me",
    ] {
        let answer = stage.ask(ask, "", None).await;
        assert_eq!((answer.status, &answer.json()["code"]), (401, &json!("unauthenticated")), "{ask}: {}", answer.text);
        assert_eq!(answer.header("content-type"), Some("application/problem+json"), "{ask}");
        assert_eq!(answer.header("www-authenticate"), Some("Bearer realm=\"starmesh\""), "{ask}");
    }
    for ask in
        ["GET /healthz", "GET /assets/login.js", "GET /assets/starmesh.css", "GET /assets/theme.js", "GET /favicon.ico"]
    {
        assert_eq!(stage.status(ask, "").await, 200, "{ask}");
    }
    for page in ["GET /", "GET /t/paranal/callisto"] {
        let login = stage.ask(page, "", None).await;
        assert!(
            login.status == 401 && login.text.contains("/assets/login.js") && !login.text.contains("app.js"),
            "{page}"
        );
    }
    let basic = stage.ask(NETWORK, "Authorization: Basic YW5hOmZvdXI=\r\n", None).await;
    assert!(basic.status == 401 && basic.text.contains("starmesh user token add"), "{}", basic.text);
    let answer = stage.log_in_as("ana", PASSWORD, "127.0.0.1").await;
    let set = answer.header("set-cookie").unwrap();
    let (value, attributes) = set.split_once("; ").unwrap();
    assert_eq!(attributes, "Path=/; HttpOnly; SameSite=Strict");
    assert_eq!(value.len(), "starmesh=".len() + 64);
    let cookie = format!("Cookie: {}\r\n", answer.cookie());
    assert_eq!(stage.status(NETWORK, &cookie).await, 200);
    let me = stage.ask(ME, &cookie, None).await;
    assert_eq!(me.header("cache-control"), Some("no-store"));
    let me = me.json();
    assert_eq!(
        (&me["name"], &me["way"], &me["rights"]),
        (&json!("ana"), &json!("session"), &json!(["operator:paranal/*"]))
    );
    assert!(me["session_ends_utc"].is_string());
    assert!(stage.ask("GET /", &cookie, None).await.text.contains("app.js"));
    // Other notations of a cookie, and what is no proof.
    let secret = &value["starmesh=".len()..];
    for (wrong, expected) in [
        (format!("Cookie: other=1; starmesh={secret}; x=2\r\n"), 200),
        (format!("Cookie: starmesh={secret}; starmesh={secret}\r\n"), 401),
        (format!("Cookie: Starmesh={secret}\r\n"), 401),
        (format!("Cookie: __Host-starmesh={secret}\r\n"), 401),
        (format!("Cookie: starmesh={}\r\n", &secret[1..]), 401),
        (format!("Authorization: Bearer {secret}\r\n"), 401),
        (format!("Authorization: Bearer x\r\n{cookie}"), 401),
        (format!("Authorization: Bearer\r\n{cookie}"), 401),
        (format!("X-Remote-User: eve\r\n{cookie}"), 200),
        ("X-Remote-User: eve\r\n".to_owned(), 401),
        ("X-Forwarded-For: 127.0.0.1\r\n".to_owned(), 401),
    ] {
        assert_eq!(stage.status(NETWORK, &wrong).await, expected, "{wrong}");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_ends_at_logout_cannot_be_fixed_or_replayed_and_is_worth_nothing_at_another_server() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    // An attacker puts an id of its own into the browser of somebody who then logs in.
    let fixed = format!("Cookie: starmesh={}\r\n", "a".repeat(64));
    let body = json!({"name": "ana", "password": PASSWORD});
    let first = stage.ask("POST /api/v1/login", &fixed, Some(&body)).await;
    assert_eq!(stage.status(ME, &fixed).await, 401);
    let first = format!("Cookie: {}\r\n", first.cookie());
    // A user who logs in again gets another id, and the one before is worth nothing.
    let second = stage.ask("POST /api/v1/login", &first, Some(&body)).await;
    let second = format!("Cookie: {}\r\n", second.cookie());
    assert_eq!((stage.status(ME, &first).await, stage.status(ME, &second).await), (401, 200));
    let other_folder = with_users();
    let other = Stage::start_with("", other_folder.path()).await;
    assert_eq!(other.status(ME, &second).await, 401);
    let other_host = stage.session("ana").await;
    let list = stage.ask("GET /api/v1/sessions", &second, None).await.json();
    assert_eq!(list["items"].as_array().unwrap().len(), 2, "{list}");
    let current: Vec<&Value> =
        list["items"].as_array().unwrap().iter().filter(|item| item["current"] == true).collect();
    assert!(current.len() == 1 && current[0]["user"] == "ana" && current[0]["address"] == "127.0.0.1", "{list}");
    assert!(!list.to_string().contains(&second[17..40]), "the list proves nothing");
    let out = stage.ask("POST /api/v1/logout", &second, None).await;
    assert!(out.status == 204 && out.header("set-cookie").unwrap().contains("Max-Age=0"), "{}", out.head);
    assert_eq!((stage.status(ME, &second).await, stage.status(ME, &other_host).await), (401, 200));
    // An engineer ends sessions of others; nobody else does.
    let id = stage.ask("GET /api/v1/sessions", &other_host, None).await.json()["items"][0]["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let eve = stage.session("eve").await;
    let eves = stage.ask("GET /api/v1/sessions", &eve, None).await.json();
    let eves_id = eves["items"].as_array().unwrap().iter().find(|item| item["user"] == "eve").unwrap()["id"].clone();
    assert_eq!(stage.status(&format!("DELETE /api/v1/sessions/{}", eves_id.as_str().unwrap()), &other_host).await, 404);
    assert_eq!(stage.status(&format!("DELETE /api/v1/sessions/{id}"), &eve).await, 204);
    assert_eq!((stage.status(ME, &other_host).await, stage.status(ME, &eve).await), (401, 200));
    other.end().await;
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_made_and_printed_once_and_never_gives_more_than_its_maker_has() {
    let folder = with_users();
    let stage = Stage::start_with("", folder.path()).await;
    let ana = stage.session("ana").await;
    let add = async |by: &str, body: Value| stage.ask("POST /api/v1/tokens", by, Some(&body)).await;
    let made = add(&ana, json!({"name": "cron", "days": 30, "rights": ["viewer:paranal/*"]})).await;
    assert_eq!(made.status, 201, "{}", made.text);
    let secret = made.json()["token"].as_str().unwrap().to_owned();
    assert!(secret.starts_with("starmesh_") && secret.len() == 9 + 64);
    let token = format!("Authorization: Bearer {secret}\r\n");
    let me = stage.ask(ME, &token, None).await.json();
    assert_eq!(
        (&me["name"], &me["way"], &me["rights"]),
        (&json!("ana"), &json!("token"), &json!(["viewer:paranal/*"]))
    );
    assert_eq!(stage.status(NETWORK, &token.to_lowercase().replace("authorization", "AUTHORIZATION")).await, 200);
    for (body, status) in [
        (json!({"name": "cron", "days": 1}), 409),
        (json!({"name": "a", "days": 1, "rights": ["engineer:paranal/*"]}), 403),
        (json!({"name": "a", "days": 1, "rights": ["viewer"]}), 403),
        (json!({"name": "a", "days": 1, "rights": ["viewer:teide/*"]}), 403),
        (json!({"name": "a", "days": 1, "user": "eve"}), 403),
        (json!({"name": "a", "days": 0}), 422),
        (json!({"name": "a", "days": 1, "rights": []}), 422),
        (json!({"name": "a", "days": 99999}), 422),
        (json!({"name": "a/b", "days": 1}), 422),
        (json!({"name": "a", "days": 1, "colour": 7}), 422),
        (json!({"name": "a"}), 422),
        (json!(["a"]), 422),
    ] {
        let answer = add(&ana, body.clone()).await;
        assert_eq!(answer.status, status, "{body}: {}", answer.text);
    }
    assert_eq!(add(&token, json!({"name": "child", "days": 3650})).await.status, 403, "a token makes no token");
    let eve = stage.session("eve").await;
    assert_eq!(add(&eve, json!({"name": "of-ana", "days": 1, "user": "ana"})).await.status, 201);
    assert_eq!(add(&eve, json!({"name": "of-nobody", "days": 1, "user": "bob"})).await.status, 422);
    assert_eq!(add(&eve, json!({"name": "own", "days": 1})).await.status, 201);
    let names = async |by: &str| {
        let list = stage.ask("GET /api/v1/tokens", by, None).await;
        assert!(!list.text.contains(&secret) && !list.text.contains("sha256"), "{}", list.text);
        let items = list.json()["items"].as_array().unwrap().clone();
        items.iter().map(|item| item["name"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(names(&ana).await, ["cron", "of-ana"]);
    assert_eq!(names(&eve).await, ["cron", "of-ana", "own"]);
    assert_eq!(stage.status("DELETE /api/v1/tokens/own", &ana).await, 404);
    assert_eq!(stage.status("DELETE /api/v1/tokens/cron", &ana).await, 204);
    assert_eq!(stage.status(NETWORK, &token).await, 401, "it counts at once");
    let file = std::fs::read_to_string(folder.path().join("users.toml")).unwrap();
    assert!(!file.contains(&secret) && file.contains("of-ana") && !file.contains("\"cron\""), "{file}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_has_expired_or_whose_user_is_gone_is_refused() {
    let folder = with_users();
    let utc = |text: &str| text.parse::<Utc>().unwrap();
    let add = |name: &str, user: &str, right: Option<&str>, expires: &str| {
        let (name, user) = (name.parse().unwrap(), user.parse().unwrap());
        let rights = right.map(|right| vec![right.parse().unwrap()]);
        let secret = change(folder.path(), |users| {
            users.add_token(name, user, rights, utc("2020-01-01T00:00:00Z"), utc(expires)).unwrap()
        });
        format!("Authorization: Bearer {}\r\n", secret.reveal())
    };
    let (past, future) = ("2020-02-01T00:00:00Z", "2200-01-01T00:00:00Z");
    let (old, new) = (add("old", "ana", None, past), add("new", "ana", None, future));
    let (other, empty) = (add("other", "eve", None, future), add("empty", "ana", Some("viewer:teide/*"), future));
    let stage = Stage::start_with("", folder.path()).await;
    let expired = stage.ask(ME, &old, None).await;
    assert!(expired.status == 401 && expired.text.contains("expired"), "{}", expired.text);
    assert_eq!((stage.status(ME, &new).await, stage.status(ME, &other).await), (200, 200));
    assert_eq!(stage.status(NETWORK, &empty).await, 403, "of what it was made for, its user may nothing any more");
    change(folder.path(), |users| assert!(users.remove(&"ana".parse().unwrap())));
    let gone = async {
        while stage.status(ME, &new).await != 401 {
            tokio::time::sleep(std::time::Duration::from_millis(100)).await
        }
    };
    tokio::time::timeout(test_support::LIMIT, gone).await.unwrap();
    assert_eq!(stage.status(ME, &other).await, 200);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_proxy_that_is_trusted_names_its_user_and_nobody_else_does() {
    let folder = with_users();
    let web = "trust_proxy = [\"127.0.0.9/32\"]\nproxy_right = \"viewer:paranal/*\"\n";
    let stage = Stage::start_with(web, folder.path()).await;
    let from = async |source: &str, headers: &str| {
        let text = request(stage.authority(), ME, headers, None);
        exchange(stage.connect_from(source).await.unwrap(), &text).await
    };
    let named = from("127.0.0.9", "X-Remote-User: ana\r\nX-Forwarded-For: 6.6.6.6, 192.0.2.7\r\n").await.json();
    assert_eq!(
        (&named["name"], &named["way"], &named["rights"]),
        (&json!("ana"), &json!("proxy"), &json!(["operator:paranal/*"]))
    );
    let stranger = from("127.0.0.9", "X-Remote-User: bob\r\n").await.json();
    assert_eq!((&stranger["name"], &stranger["rights"]), (&json!("bob"), &json!(["viewer:paranal/*"])));
    for (source, headers, status) in [
        ("127.0.0.1", "X-Remote-User: ana\r\n", 401),
        ("127.0.0.9", "", 401),
        ("127.0.0.9", "X-Remote-User: \r\n", 403),
        ("127.0.0.9", "X-Remote-User: a b/c\r\n", 403),
        ("127.0.0.9", "X-Remote-User: bob\r\nx-remote-user: eve\r\n", 400),
    ] {
        assert_eq!(from(source, headers).await.status, status, "{source} {headers}");
    }
    // Behind TLS of the proxy the cookie is one of TLS.
    let body = json!({"name": "ana", "password": PASSWORD});
    let proxied = "X-Forwarded-Proto: https\r\nX-Forwarded-For: 6.6.6.6, 192.0.2.7\r\n";
    let text = request(stage.authority(), "POST /api/v1/login", proxied, Some(&body));
    let answer = exchange(stage.connect_from("127.0.0.9").await.unwrap(), &text).await;
    let set = answer.header("set-cookie").unwrap();
    assert!(set.starts_with("__Host-starmesh=") && set.ends_with("; Secure"), "{set}");
    let headers = format!("{proxied}Cookie: {}\r\n", answer.cookie());
    let text = request(stage.authority(), "GET /api/v1/sessions", &headers, None);
    let list = exchange(stage.connect_from("127.0.0.9").await.unwrap(), &text).await.json();
    assert_eq!(
        list["items"][0]["address"], "192.0.2.7",
        "the address that the proxy saw, not the one that the client claims"
    );
    stage.end().await;
}
