//! The members that all ASCOM devices share, and the rule that a device must be connected for the rest.

use serde_json::{Value, json};

use crate::answer::{Answer, DONE, Refusal};
use crate::dome;
use crate::kind::Kind;
use crate::observatory::Observatory;
use crate::request::Request;

/// Members that answer without a connection.
const ALWAYS: &[&str] = &[
    "connect",
    "connected",
    "connecting",
    "description",
    "disconnect",
    "driverinfo",
    "driverversion",
    "interfaceversion",
    "name",
    "supportedactions",
];

/// Answers a request to a device, whose connection is `connected`.
pub fn ask(observatory: &mut Observatory, connected: &mut bool, kind: Kind, request: &Request) -> Answer {
    let member = request.member.as_str();
    if !*connected && !ALWAYS.contains(&member) {
        // A member that does not exist is reported as such, connected or not.
        return match if request.is_put { DONE } else { observatory.ask(kind, request) } {
            Err(Refusal::UnknownMember) if !request.is_put && !is_common(member) => Err(Refusal::UnknownMember),
            _ => Err(Refusal::not_connected()),
        };
    }
    match (request.is_put, member) {
        (false, "connected") => Ok(json!(*connected)),
        (true, "connected") => {
            *connected = request.truth("Connected")?;
            DONE
        }
        (true, "connect" | "disconnect") => {
            *connected = member == "connect";
            DONE
        }
        (false, "connecting") => Ok(json!(false)),
        (false, "description") => Ok(json!(format!("simulated {} under a simulated sky", kind.ascom()))),
        (false, "driverinfo") => Ok(json!("Starmesh simulator")),
        (false, "driverversion") => Ok(json!(env!("CARGO_PKG_VERSION"))),
        (false, "interfaceversion") => Ok(json!(kind.interface_version())),
        (false, "name") => Ok(json!(name(kind))),
        (false, "supportedactions") => Ok(json!(actions(kind))),
        (false, "devicestate") => Ok(state(observatory, kind)),
        (true, "action") => {
            let action = request.text("Action")?.to_ascii_lowercase();
            let parameters = request.text("Parameters")?;
            if kind == Kind::Dome {
                observatory.dome.action(&action, parameters)
            } else {
                Err(Refusal::action_not_implemented(&action))
            }
        }
        (true, "commandstring") if kind == Kind::Telescope && observatory.telescope.vendor.is_some() => {
            let command = request.text("Command")?;
            request.truth("Raw")?;
            observatory.telescope.vendor.as_mut().map_or(DONE, |vendor| vendor.command_string(command))
        }
        (true, "commandblind" | "commandbool" | "commandstring") => Err(Refusal::not_implemented(member)),
        _ => observatory.ask(kind, request),
    }
}

/// The name of a device.
pub fn name(kind: Kind) -> String {
    let what = if kind == Kind::GuideCamera { "guide camera" } else { kind.ascom() };
    format!("Simulated {what}")
}

fn actions(kind: Kind) -> &'static [&'static str] {
    if kind == Kind::Dome { dome::ACTIONS } else { &[] }
}

fn is_common(member: &str) -> bool {
    matches!(member, "devicestate" | "action" | "commandblind" | "commandbool" | "commandstring")
}

/// `DeviceState`: all properties that change, in one answer. As in ASCOM, a property that has no value now is left out.
fn state(observatory: &mut Observatory, kind: Kind) -> Value {
    let mut answer = Vec::new();
    for name in Observatory::state_properties(kind) {
        let request = Request::new(false, &name.to_ascii_lowercase(), "");
        if let Ok(value) = observatory.ask(kind, &request) {
            answer.push(json!({ "Name": name, "Value": value }));
        }
    }
    let now = observatory.scene().now.strftime("%Y-%m-%dT%H:%M:%S.%6fZ");
    answer.push(json!({ "Name": "TimeStamp", "Value": now }));
    Value::Array(answer)
}
