//! Scripts that want more than they may have: each is ended, and its thread with it.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use test_support::until;

use super::call::CallError;
use super::line::{Host, HostAnswer, Reply, Request};
use super::script::{Function, Script};

/// Answers like a site whose sleep is real and whose every device command fails.
#[derive(Default)]
struct FakeHost {
    asked: Mutex<Vec<Request>>,
}

impl Host for FakeHost {
    async fn answer(&self, request: Request) -> HostAnswer {
        self.asked.lock().unwrap().push(request.clone());
        match request {
            Request::Sleep(s) => {
                tokio::time::sleep(Duration::from_secs_f64(s)).await;
                Ok(Reply::Done)
            }
            Request::Vendor(..) => Err("the link is lost".to_owned()),
            Request::State(_) => {
                Ok(Reply::Fields(serde_json::json!({"at_park": true, "ra_deg": 1.5, "list": [1, null]})))
            }
            Request::IsSafe => Ok(Reply::Truth(true)),
            _ => Ok(Reply::Done),
        }
    }
}

impl FakeHost {
    fn notes(&self) -> Vec<String> {
        let asked = self.asked.lock().unwrap();
        let note = |request: &Request| match request {
            Request::Note(text) => Some(text.clone()),
            _ => None,
        };
        asked.iter().filter_map(note).collect()
    }
}

/// Only what hangs takes so long.
const LONG: Duration = Duration::from_secs(600);
const SHORT: Duration = Duration::from_millis(300);

/// Runs `open` of a script; waits until its thread has ended.
async fn run(text: &str, most: Duration) -> (Result<String, CallError>, FakeHost) {
    let (script, host) = (Script::compile(text).unwrap(), FakeHost::default());
    // The other tests of this process may take memory meanwhile.
    let result = script.call_within(Function::Open, most, u64::MAX, &host).await;
    until(&format!("the thread has ended: {text}"), || Arc::strong_count(&script.ast) == 1).await;
    (result.map(|value| value.to_string()), host)
}

fn why(result: Result<String, CallError>) -> String {
    result.unwrap_err().to_string()
}

#[tokio::test]
async fn a_script_gets_its_answers_and_gives_one() {
    let text =
        "fn open() { let s = state(\"telescope\"); if is_safe() && s.at_park && s.list[1] == () { s.ra_deg * 2 } }";
    assert_eq!(run(text, LONG).await.0.unwrap(), "3.0");
    let (_, host) = run("fn open() { open_domes(); open_covers(); unpark(); default_open(); sleep(0); }", LONG).await;
    let asked = host.asked.lock().unwrap().clone();
    let parts = [Request::OpenDomes, Request::OpenCovers, Request::Unpark, Request::Default, Request::Sleep(0.0)];
    assert_eq!(asked, parts);
}

#[tokio::test]
async fn what_fails_is_thrown_with_its_place_and_can_be_caught() {
    let message = why(run("fn open() {\n  command_string(\"telescope\", \"X\");\n}", LONG).await.0);
    assert!(message.contains("the link is lost") && message.contains("line 2"), "{message}");
    let caught = "fn open() { try { action(\"dome\", \"X\", \"1\"); } catch (why) { note(`caught: ${why}`); } }";
    let (result, host) = run(caught, LONG).await;
    assert!(result.is_ok());
    assert_eq!(host.notes(), ["caught: the link is lost"]);
    assert!(why(run("fn open() { throw \"no\" }", LONG).await.0).contains("no"));
}

#[tokio::test]
async fn an_endless_loop_is_ended_by_its_time() {
    for text in [
        "fn open() { loop { } }",
        "fn open() { sleep(3600); }",
        "fn open() { sleep(3600.5); }",
        // Nothing of it can be caught.
        "fn open() { loop { try { sleep(3600); } catch { } } }",
        "fn open() { loop { try { loop { } } catch { } } }",
    ] {
        let message = why(run(text, SHORT).await.0);
        assert!(message.contains("not done within 0.3 s"), "{text}: {message}");
    }
}

#[tokio::test]
async fn a_call_that_is_dropped_ends_its_script() {
    let script = Script::compile("fn open() { loop { } }").unwrap();
    let host = FakeHost::default();
    let dropped = tokio::time::timeout(Duration::from_millis(50), script.call(Function::Open, LONG, &host));
    assert!(dropped.await.is_err());
    until("the thread has ended", || Arc::strong_count(&script.ast) == 1).await;
}

#[tokio::test]
async fn a_memory_bomb_is_ended_while_it_is_small() {
    for (text, word) in [
        ("fn open() { let s = \"x\"; loop { s += s; } }", "length of string"),
        ("fn open() { let s = \"\"; s.pad(100000000, 'x'); }", "length of string"),
        ("fn open() { let a = []; loop { a.push(1); } }", "size of array"),
        ("fn open() { let a = []; a.pad(100000000, 1); }", "size of array"),
        ("fn open() { let a = [1]; loop { a = [a, a]; } }", "size of array"),
    ] {
        let message = why(run(text, LONG).await.0);
        assert!(message.to_lowercase().contains(word), "{text}: {message}");
    }
}

#[tokio::test]
async fn no_file_no_network_and_no_process_can_be_reached() {
    for call in [
        "open_file(\"/etc/passwd\")",
        "read_file(\"/etc/passwd\")",
        "load(\"/etc/passwd\")",
        "http_get(\"http://127.0.0.1/\")",
        "connect(\"127.0.0.1:11111\")",
        "system(\"id\")",
        "exec(\"id\")",
        "env(\"HOME\")",
    ] {
        let message = why(run(&format!("fn open() {{ {call} }}"), LONG).await.0);
        assert!(message.contains("Function not found"), "{call}: {message}");
    }
    assert!(Script::compile("import \"/etc/passwd\" as p;").is_err());
    assert!(Script::compile("fn open() { eval(\"1\") }").is_err());
}
