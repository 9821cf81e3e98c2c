//! Publishes which actions there are and which parameters they accept: for forms, and for programs that write
//! schedules.

use bus::{BusError, Service};
use contract::Key;
use contract::observatory::{ActionAnswer, ActionQuestion};
use node::Node;
use schedule::action::{ACTIONS, Entry};

/// Answers until the service is dropped; a plain `get`, and a question that cannot be read, with all actions.
pub async fn serve(node: &Node) -> Result<Service, BusError> {
    let key = Key::Actions(node.config.address());
    let answering = |asked: Result<ActionQuestion, String>| async move { answer(&asked.unwrap_or_default()) };
    node.bus.serve(&key, answering).await
}

fn answer(question: &ActionQuestion) -> ActionAnswer {
    let is_wanted = |entry: &&Entry| question.action.as_ref().is_none_or(|name| name == entry.name);
    ActionAnswer { actions: ACTIONS.iter().filter(is_wanted).map(Entry::summary).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_action_or_all_are_answered_and_an_unknown_one_is_none() {
        let names = |action: Option<&str>| -> Vec<String> {
            let question = ActionQuestion { action: action.map(str::to_owned) };
            answer(&question).actions.into_iter().map(|action| action.name).collect()
        };
        assert_eq!(names(None).len(), ACTIONS.len());
        assert_eq!(names(Some("calibration")), ["calibration"]);
        assert!(names(Some("objekt")).is_empty());
    }

    #[test]
    fn the_schema_holds_what_a_form_needs() {
        let kind = answer(&ActionQuestion { action: Some("object".to_owned()) }).actions.remove(0);
        assert!(kind.needs_safe_sky && kind.moves_mount);
        let (schema, of) = (&kind.schema, |name: &str| kind.schema["properties"][name].clone());
        assert_eq!(schema["required"], serde_json::json!(["object", "exptime"]));
        assert_eq!(schema["additionalProperties"], false);
        assert_eq!((&of("exptime")["unit"], &of("exptime")["maximum"]), (&"s".into(), &86_400.into()));
        assert_eq!((&of("bin")["default"], &of("bin")["minimum"]), (&1.into(), &1.into()));
        assert_eq!(of("subframe_center_x")["default"], 0.5);
        assert_eq!(kind.example["object"], "TRAPPIST-1");
        // No line ends and no widths of Rust's numbers.
        let text = schema.to_string();
        assert!(!text.contains("\\n") && !text.contains("uint32") && !text.contains("\"double\""), "{text}");
    }
}
