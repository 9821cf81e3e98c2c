//! E-mail: encrypted, logged in, or not sent at all.

use std::time::Duration;

use crate::authority::Authority;
use crate::post_office::{PostOffice, Rules};
use crate::site::Site;

/// A site that mails `to` through this office; the file `ca.pem` contains this authority.
async fn site(office: &PostOffice, authority: &Authority, smtp: &str, to: &[&str]) -> Site {
    let port = office.port;
    let config = format!(
        "[alerts]\nca_file = \"ca.pem\"\n[alerts.smtp]\nserver = \"localhost\"\nport = {port}\n\
         from = \"Callisto <t@example.org>\"\n{smtp}[[alerts.email]]\nname = \"night\"\nto = {to:?}\n"
    );
    Site::open(&config, &[("ca.pem", &authority.pem()), ("password", "s3cret-Pa55\n")]).await
}

const LOGIN: &str = "user = \"callisto\"\npassword_file = \"password\"\n";
const ANA: &[&str] = &["ana@example.org"];

#[tokio::test(flavor = "multi_thread")]
async fn mail_goes_out_encrypted_and_logged_in() {
    let authority = Authority::new("site CA");
    let server = || Some(authority.server(&["localhost"]));
    let cases = [
        ("starttls", Rules { starttls: server(), login: Some("PLAIN"), ..Rules::default() }, LOGIN, true),
        ("starttls", Rules { starttls: server(), login: Some("LOGIN"), ..Rules::default() }, LOGIN, true),
        ("tls", Rules { tls: server(), login: Some("PLAIN"), ..Rules::default() }, LOGIN, true),
        ("tls", Rules { tls: server(), login: Some("LOGIN"), ..Rules::default() }, LOGIN, true),
        ("tls", Rules { tls: server(), ..Rules::default() }, "", false),
    ];
    for (security, rules, login, logs_in) in cases {
        let name = format!("{security} {:?}", rules.login);
        let office = PostOffice::open(rules).await;
        let site = site(&office, &authority, &format!("security = \"{security}\"\n{login}"), ANA).await;
        let id = site.raise("dome");
        site.until(&name, || !office.mails().is_empty()).await;
        let mail = office.mails().remove(0);
        assert!(mail.encrypted && mail.logged_in == logs_in, "{name}: {mail:?}");
        assert!(mail.text.contains(&id) && mail.text.contains("What to do"), "{name}: {mail:?}");
        let open: &[&str] = if security == "tls" { &[] } else { &["EHLO", "STARTTLS"] };
        assert_eq!(office.sent_in_the_open(), open, "{name}: nothing else is sent in the open");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_protects_or_accepts_nothing_gets_no_mail_and_the_alert_gives_the_reason() {
    let (known, unknown) = (Authority::new("site CA"), Authority::new("somebody"));
    let good = || Some(known.server(&["localhost"]));
    let cases = [
        ("starttls", Rules { login: Some("PLAIN"), ..Rules::default() }, "offers no STARTTLS, and nothing goes there"),
        ("starttls", Rules { starttls: good(), ..Rules::default() }, "offers no login by PLAIN or LOGIN"),
        (
            "starttls",
            Rules { starttls: Some(unknown.server(&["localhost"])), ..Rules::default() },
            "name the authority's certificate in alerts.ca_file",
        ),
        (
            "tls",
            Rules { tls: Some(known.expired_server(&["localhost"])), ..Rules::default() },
            "has expired: have it renewed",
        ),
        ("tls", Rules { tls: Some(known.server(&["mail.example.org"])), ..Rules::default() }, "is for another host"),
        ("tls", Rules { starttls: good(), ..Rules::default() }, "does not speak TLS on this port"),
    ];
    let mut running = Vec::new();
    for (security, rules, wanted) in cases {
        let office = PostOffice::open(rules).await;
        let site = site(&office, &known, &format!("security = \"{security}\"\n{LOGIN}"), ANA).await;
        site.raise("dome");
        running.push((site, office, wanted));
    }
    for (site, office, wanted) in running {
        let why = site.why_not("night").await;
        assert!(why.contains(wanted), "{wanted:?} is not in {why:?}");
        assert_eq!(office.mails().len(), 0, "{wanted}");
        let open = office.sent_in_the_open();
        assert!(open.iter().all(|word| ["EHLO", "STARTTLS", "QUIT"].contains(&word.as_str()) || !word.is_ascii()));
        site.hides(&["s3cret-Pa55", "AGNhbGxpc3RvAHMzY3JldC1QYTU1", "czNjcmV0LVBhNTU="]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_password_is_an_alert_and_the_mail_comes_once_it_is_mended() {
    tokio::join!(wrong_password("PLAIN"), wrong_password("LOGIN"));
}

async fn wrong_password(way: &'static str) {
    let authority = Authority::new("site CA");
    let rules = Rules { starttls: Some(authority.server(&["localhost"])), login: Some(way), ..Rules::default() };
    let office = PostOffice::open(rules).await;
    let site = site(&office, &authority, LOGIN, ANA).await;
    std::fs::write(site.path().join("password"), "wr0ng-word").unwrap();
    let id = site.raise("dome");
    let why = site.why_not("night").await;
    assert!(why.contains("refuses the login: look at alerts.smtp.user and its password"), "{why}");
    assert_eq!(why.matches("5.7.8 wrong name or password").count(), 1, "the server's words, once: {why}");
    std::fs::write(site.path().join("password"), "s3cret-Pa55").unwrap();
    let later = site.raise("second");
    let came = |id: &str| office.mails().iter().filter(|mail| mail.text.contains(id)).count();
    site.until("both mails come", || came(&id) == 1 && came(&later) == 1).await;
    site.until("the alert ends", || site.undelivered("night").is_none()).await;
    site.hides(&["wr0ng-word", "s3cret-Pa55", "d3Iwbmctd29yZA=="]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_repeats_the_login_puts_it_nowhere() {
    let authority = Authority::new("site CA");
    // As it came, as it is, and in hex and percent codes of the server's own.
    let words = "that is s3cret-Pa55 or s3cret%2DPa55 or 7333637265742d50613535";
    let rules = Rules {
        starttls: Some(authority.server(&["localhost"])),
        login: Some("PLAIN"),
        repeats: Some(words),
        ..Rules::default()
    };
    let office = PostOffice::open(rules).await;
    let site = site(&office, &authority, LOGIN, ANA).await;
    site.raise("dome");
    let why = site.why_not("night").await;
    assert!(why.contains("refuses the login: look at alerts.smtp.user and its password"), "{why}");
    assert!(why.contains("[hidden]"), "{why}");
    let codes = ["AGNhbGxpc3RvAHMzY3JldC1QYTU1", "czNjcmV0LVBhNTU", "s3cret%2DPa55", "7333637265742d50613535"];
    site.hides(&["s3cret-Pa55"]);
    site.hides(&codes);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_that_is_refused_keeps_the_mail_from_nobody_else() {
    let authority = Authority::new("site CA");
    let rules =
        Rules { tls: Some(authority.server(&["localhost"])), unknown: vec!["bob@example.org"], ..Rules::default() };
    let office = PostOffice::open(rules).await;
    let all = ["ana@example.org", "bob@example.org", "eve@example.org"];
    let site = site(&office, &authority, "security = \"tls\"\n", &all).await;
    let id = site.raise("dome");
    let got = |who: &str, id: &str| {
        let mails = office.mails();
        mails.iter().filter(|mail| mail.to.iter().any(|to| to.contains(who)) && mail.text.contains(id)).count()
    };
    let why = site.why_not("night/2").await;
    assert!(why.contains("no such mailbox"), "{why}");
    for who in ["ana@", "eve@"] {
        site.until("the others learn of it", || got(who, "alert-not-sent/night/2") == 1).await;
        site.until("they learn of the dome", || got(who, &format!("raised: {id}")) == 1).await;
    }
    let mail = office.mails().remove(0);
    assert!(mail.to.len() == 1 && all.iter().all(|to| mail.text.contains(to)), "its head names all: {mail:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_answers_nothing_at_the_end_gets_the_mail_once() {
    let authority = Authority::new("site CA");
    let rules = Rules { tls: Some(authority.server(&["localhost"])), mute_at_end: true, ..Rules::default() };
    let office = PostOffice::open(rules).await;
    let site = site(&office, &authority, "security = \"tls\"\n", ANA).await;
    site.raise("dome");
    site.until("the arrival of the mail is published", || !site.node.alerts.watch().borrow().notifications.is_empty())
        .await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(office.mails().len(), 1);
}
