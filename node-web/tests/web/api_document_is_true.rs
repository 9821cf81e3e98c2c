//! The OpenAPI document that is served: what the repository shows, and true of what is answered.

use crate::stage::Stage;

#[tokio::test(flavor = "multi_thread")]
async fn the_document_that_is_served_is_the_one_in_the_repository() {
    let stage = Stage::start().await;
    let (status, document) = stage.get("/api/openapi.json").await;
    assert_eq!(status.as_u16(), 200);
    whole::is("docs/api/openapi.json", &(serde_json::to_string_pretty(&document).unwrap() + "\n"));
    let page = stage.http.get(format!("{}/api/docs", stage.url)).send().await.unwrap().text().await.unwrap();
    for (path, _) in document["paths"].as_object().unwrap() {
        assert!(page.contains(path.as_str()), "{path}");
    }
    assert!(!page.contains("<script") && !page.contains("http"), "the page needs nothing from elsewhere");
    let (documented, rows) = (include_str!("../../../docs/api.md"), page.matches("id=\"problem-").count());
    assert_eq!(
        documented
            .lines()
            .filter(|line| line.starts_with("| `") && line.matches('|').count() == 4)
            .filter(|line| {
                let mut cells = line.split('|').map(str::trim).skip(1);
                let (code, status) = (cells.next().unwrap().trim_matches('`'), cells.next().unwrap());
                let meaning = cells.next().unwrap();
                page.contains(&format!("id=\"problem-{code}\"><h3>{code}</h3><p>Status {status}. {meaning}</p>"))
            })
            .count(),
        rows,
        "docs/api.md and /api/docs list the same problems"
    );
    let (status, wrong) = stage.get("/api/v1/telescopes/paranal/nobody").await;
    assert_eq!((status.as_u16(), &wrong["code"]), (404, &serde_json::json!("not-found")));
    let answer = stage.http.get(format!("{}{}", stage.url, wrong["type"].as_str().unwrap())).send().await.unwrap();
    assert_eq!((answer.status().as_u16(), answer.url().path()), (200, "/api/docs"));
    let (_, bus) = stage.get("/api/asyncapi.json").await;
    assert_eq!(bus["asyncapi"], "3.0.0");
    let (_, socket) = stage.get("/api/socket.json").await;
    whole::is("docs/api/socket.json", &(serde_json::to_string_pretty(&socket).unwrap() + "\n"));
    stage.end().await;
}

#[path = "../../../common/contract/tests/whole/mod.rs"]
mod whole;
