//! Commands of a maker's own: checked against the list in the device's block, sent, and their answer returned.

use alpaca::{Alpaca, AlpacaError};
use config::VendorPattern;
use contract::device::vendor::{LONGEST_ANSWER, VendorCommand, Words};
use contract::{NoData, Reason};
use serde_json::Value;

use super::Executed;

/// No state shows whether such a command was done: without an answer it has failed.
pub const UNANSWERED: &str = "no answer came, so that it is not known whether the device received it";

/// Why a command is not sent.
pub fn refuse(listed: &[&[VendorPattern]], command: &VendorCommand) -> Option<(Reason, String)> {
    let allowed = listed.iter().any(|list| is_listed(list, command));
    (!allowed).then(|| {
        let (method, text) = (command.method(), command.text());
        let detail = format!("\"{method} {text}\" is not in vendor_commands of the device's block; add it there");
        (Reason::NotImplemented, detail)
    })
}

/// Does one of the lines allow it?
pub fn is_listed(listed: &[VendorPattern], command: &VendorCommand) -> bool {
    listed.iter().any(|pattern| pattern.allows(command))
}

/// Sends it and waits for the answer.
pub async fn execute(alpaca: &Alpaca, command: &VendorCommand) -> Result<Executed, AlpacaError> {
    let ask = async |member: &str, Words { command, raw }: &Words| {
        let raw = if *raw { "True" } else { "False" };
        alpaca.call(member, &[("Command", command), ("Raw", raw)]).await
    };
    let answer = match command {
        VendorCommand::CommandString(words) => ask("commandstring", words).await?,
        VendorCommand::CommandBool(words) => ask("commandbool", words).await?,
        VendorCommand::CommandBlind(words) => {
            ask("commandblind", words).await?;
            return Ok(Executed::Done);
        }
        VendorCommand::Action { name, parameters } => {
            alpaca.call("action", &[("Action", name), ("Parameters", parameters)]).await?
        }
    };
    as_text(answer).map(Executed::Answered)
}

/// An answer as text: of `true` and numbers their JSON, of nothing no text.
fn as_text(answer: Option<Value>) -> Result<String, AlpacaError> {
    let text = match answer {
        None | Some(Value::Null) => String::new(),
        Some(Value::String(text)) => text,
        Some(other) => other.to_string(),
    };
    if text.len() > LONGEST_ANSWER {
        let detail = format!("the answer has {} bytes; at most {LONGEST_ANSWER} are passed on", text.len());
        return Err(AlpacaError::Value(NoData::new("answer too long", detail)));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn an_answer_is_reported_as_text_and_never_cut() {
        assert_eq!(as_text(Some(json!("a|1"))).unwrap(), "a|1");
        assert_eq!(as_text(Some(json!(true))).unwrap(), "true");
        assert_eq!(as_text(Some(json!(-1))).unwrap(), "-1");
        assert_eq!(as_text(None).unwrap(), "");
        assert!(as_text(Some(json!("x".repeat(LONGEST_ANSWER)))).is_ok());
        let error = as_text(Some(json!("x".repeat(LONGEST_ANSWER + 1)))).unwrap_err();
        assert!(error.to_string().contains("16385 bytes"), "{error}");
    }
}
