//! A plan for programs: one JSON object a line.

use contract::observatory::{NightPlan, RowPlan};
use schedule::plan::{PlannedNight, Site};
use serde::Serialize;
use serde_json::{Value, json};

use super::Planned;

/// Something of one file.
#[derive(Serialize)]
struct OfFile<'a, T> {
    file: &'a str,
    #[serde(flatten)]
    what: T,
}

/// The overheads, then of each file its rows and its night.
pub fn lines(planned: &[Planned], site: &Site) -> Vec<String> {
    let mut all = vec![overheads(planned, site)];
    for Planned { file, night } in planned {
        let file = &*file.display().to_string();
        let rows = night.rows.iter().map(|row| OfFile::<RowPlan> { file, what: row.published() });
        all.extend(rows.map(|row| json!(row)));
        all.push(json!(OfFile::<NightPlan> { file, what: night.sums() }));
    }
    all.iter().map(Value::to_string).collect()
}

/// Each figure with its origin.
fn overheads(planned: &[Planned], site: &Site) -> Value {
    let of_all: Vec<_> = planned.iter().flat_map(|planned| planned.night.rows.clone()).collect();
    let all = PlannedNight { rows: of_all, open_s: 0.0, closed: None, dark_s: 0.0, dark_exposed_s: 0.0 };
    let (overheads, cameras) = site.figures(&all);
    json!({ "overheads": overheads, "cameras": cameras })
}
