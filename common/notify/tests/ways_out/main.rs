//! The ways out, to real servers on this host: HTTPS and SMTP with certificates of a site's own authority, and every
//! way in which a server can fail to prove itself.
#![allow(clippy::unwrap_used, reason = "a test ends by panicking")]

mod authority;
mod mail;
mod post_office;
mod site;
mod web;

use authority::Authority;
use site::Site;
use web::Web;

fn hook(name: &str, url: &str) -> String {
    format!("[[alerts.webhook]]\nname = \"{name}\"\nurl = \"{url}\"\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn webhook_and_ping_reach_servers_of_the_sites_own_authority() {
    let authority = Authority::new("site CA");
    let web = Web::serve(Some(authority.server(&["localhost", "127.0.0.1"]))).await;
    let (by_name, by_number) = (format!("https://localhost:{}", web.port), format!("https://127.0.0.1:{}", web.port));
    let config = format!(
        "[alerts]\nca_file = \"ca.pem\"\n{}token_file = \"token\"\n{}[alerts.ping]\nurl = \"{by_name}/ping-k3y\"\n\
         period_s = 1\n",
        hook("named", &format!("{by_name}/named-p4th")),
        hook("numbered", &format!("{by_number}/numbered-p4th")),
    );
    let site = Site::open(&config, &[("ca.pem", &authority.pem()), ("token", "t0ken-of-chat\n")]).await;
    let id = site.raise("dome");
    site.until("both hooks get it", || web.count("raised", &id) == 2).await;
    site.until("pings come", || web.asked().iter().filter(|asked| asked.path == "/ping-k3y").count() >= 2).await;
    let asked = web.asked();
    let of = |path: &str| asked.iter().find(|asked| asked.path == path).unwrap().clone();
    assert_eq!(of("/named-p4th").authorization, "Bearer t0ken-of-chat");
    assert_eq!(of("/numbered-p4th").authorization, "");
    assert_eq!((of("/named-p4th").method.as_str(), of("/ping-k3y").method.as_str()), ("POST", "GET"));
    assert!(of("/named-p4th").body["text"].as_str().is_some_and(|text| text.contains("What to do")));
    assert_eq!(site.node.alerts.watch().borrow().notifications.len(), 2, "and the receivers are published");
}

#[tokio::test(flavor = "multi_thread")]
async fn ntfy_gets_a_message_for_its_topic_at_the_root_of_its_server() {
    let web = Web::serve(None).await;
    let hook = hook("phone", &format!("http://127.0.0.1:{}/callisto-4f8a", web.port));
    let config = format!("[alerts]\npage = \"https://telescopes.example.org\"\n{hook}format = \"ntfy\"\n");
    let site = Site::open(&config, &[]).await;
    let id = site.raise("dome");
    site.until("the phone gets it", || !web.asked().is_empty()).await;
    let asked = web.asked();
    assert_eq!((asked[0].method.as_str(), asked[0].path.as_str()), ("POST", "/"));
    let body = &asked[0].body;
    assert_eq!((&body["topic"], &body["priority"]), (&serde_json::json!("callisto-4f8a"), &serde_json::json!(5)));
    assert!(body["title"].as_str().is_some_and(|title| title.ends_with(&format!("critical raised: {id}"))), "{body}");
    assert!(body["message"].as_str().is_some_and(|text| text.contains("What to do")), "{body}");
    assert_eq!(body["click"], "https://telescopes.example.org/t/site/alpha");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_proves_nothing_gets_nothing_and_is_an_alert_that_names_the_remedy() {
    let (known, unknown) = (Authority::new("site CA"), Authority::new("somebody"));
    let good = Web::serve(Some(known.server(&["localhost"]))).await;
    let servers = [
        ("stranger", Some(unknown.server(&["localhost"])), "name the authority's certificate in alerts.ca_file"),
        ("expired", Some(known.expired_server(&["localhost"])), "has expired: have it renewed"),
        ("other-host", Some(known.server(&["other.example.org"])), "is for another host"),
        ("itself", Some(known.server_of_itself()), "it needs one that an authority signed"),
        ("no-tls", None, "does not speak TLS on this port"),
    ];
    let mut config = "[alerts]\nca_file = \"ca.pem\"\n".to_owned() + &hook("good", &url(&good));
    let mut webs = Vec::new();
    for (name, tls, wanted) in servers {
        let web = Web::serve(tls).await;
        config += &format!("{}token_file = \"token\"\n", hook(name, &url(&web)));
        webs.push((name, web, wanted));
    }
    config += &format!("[alerts.ping]\nurl = \"{}\"\nperiod_s = 1\n", url(&webs[0].1));
    let site = Site::open(&config, &[("ca.pem", &known.pem()), ("token", "t0ken-for-liars")]).await;
    let id = site.raise("dome");
    for (name, web, wanted) in &webs {
        let why = site.why_not(name).await;
        assert!(why.starts_with(&format!("\"{name}\" gets no alerts: ")) && why.contains(wanted), "{name}: {why}");
        assert!(web.connections() >= 3, "{name} was tried again: {}", web.connections());
        assert_eq!(web.asked().len(), 0, "{name} got nothing");
        let about = format!("alert-not-sent/{name}");
        site.until("who is reached learns of it", || good.count("raised", &about) == 1).await;
    }
    let why = site.why_not("ping").await;
    assert!(why.contains("alerts.ca_file"), "{why}");
    // A receiver that began after the alert first waits for the report of a node that may have sent it.
    site.until("who is reached learned of the dome", || good.count("raised", &id) == 1).await;

    // The authority is written into the file, and nothing was lost meanwhile.
    let both = known.pem() + &unknown.pem();
    std::fs::write(site.path().join("ca.pem"), both).unwrap();
    let later = site.raise("second");
    let (_, stranger, _) = &webs[0];
    site.until("all is sent", || stranger.count("raised", &id) == 1 && stranger.count("raised", &later) == 1).await;
    site.until("the alert ends", || site.undelivered("stranger").is_none()).await;
    site.until("that of the ping too", || site.undelivered("ping").is_none()).await;
    site.hides(&["t0ken-for-liars", "s3cret-path"]);
}

fn url(web: &Web) -> String {
    format!("https://localhost:{}/s3cret-path", web.port)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ca_file_that_is_none_is_an_alert_and_harms_no_receiver_without_tls() {
    let open = Web::serve(None).await;
    let authority = Authority::new("site CA");
    let secure = Web::serve(Some(authority.server(&["localhost"]))).await;
    let plain = format!("http://localhost:{}/", open.port);
    let config = "[alerts]\nca_file = \"ca.pem\"\n".to_owned() + &hook("open", &plain) + &hook("secure", &url(&secure));
    let site = Site::open(&config, &[("ca.pem", "not a certificate")]).await;
    let id = site.raise("dome");
    let why = site.why_not("secure").await;
    assert!(why.contains("ca.pem holds no certificate: expected PEM"), "{why}");
    site.until("who is open learns of it", || open.count("raised", &id) == 1).await;
    assert_eq!(secure.connections(), 0);
    std::fs::remove_file(site.path().join("ca.pem")).unwrap();
    site.raise("second");
    site.until("the cause is renewed", || {
        site.undelivered("secure").is_some_and(|alert| alert.cause.contains("ca.pem cannot be read"))
    })
    .await;
}
