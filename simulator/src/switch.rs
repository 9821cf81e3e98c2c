//! Switches: sockets, a dew heater, and a UPS that knows whether it is on mains.

use serde_json::{Value, json};

use crate::answer::{Answer, DONE, Refusal, within};
use crate::request::Request;

/// Properties that are read without parameters, in ASCOM's case.
pub const PROPERTIES: &[&str] = &["MaxSwitch"];

/// The properties in `DeviceState`.
pub const STATE: &[&str] = &[
    "GetSwitch0",
    "GetSwitch1",
    "GetSwitch2",
    "GetSwitch3",
    "GetSwitch4",
    "GetSwitchValue0",
    "GetSwitchValue1",
    "GetSwitchValue2",
    "GetSwitchValue3",
    "GetSwitchValue4",
    "StateChangeComplete0",
    "StateChangeComplete1",
    "StateChangeComplete2",
    "StateChangeComplete3",
    "StateChangeComplete4",
];

/// Number of the switch that reports whether the UPS has mains power.
pub const ON_MAINS: usize = 3;
const BATTERY: usize = 4;
/// Percent of charge per sky second, without and with mains.
const DISCHARGE: f64 = 100.0 / 1800.0;
const CHARGE: f64 = 100.0 / 7200.0;

#[derive(Debug)]
struct Socket {
    name: String,
    description: &'static str,
    max: f64,
    writable: bool,
    value: f64,
}

/// A box of switches.
#[derive(Debug)]
pub struct Switch {
    sockets: Vec<Socket>,
}

impl Default for Switch {
    fn default() -> Self {
        let socket = |name: &str, description, max, writable, value| Socket {
            name: name.to_owned(),
            description,
            max,
            writable,
            value,
        };
        Self {
            sockets: vec![
                socket("Mount power", "socket of the mount", 1.0, true, 1.0),
                socket("Camera power", "socket of the camera", 1.0, true, 1.0),
                socket("Dew heater", "power of the dew heater, percent", 100.0, true, 0.0),
                socket("UPS on mains", "whether the UPS has mains power", 1.0, false, 1.0),
                socket("UPS battery", "charge of the UPS, percent", 100.0, false, 100.0),
            ],
        }
    }
}

impl Switch {
    /// Cuts or restores the mains.
    pub fn set_on_mains(&mut self, on_mains: bool) {
        self.sockets[ON_MAINS].value = f64::from(u8::from(on_mains));
    }

    /// Lets sky time pass.
    pub fn advance(&mut self, dt: f64) {
        let per_s = if self.sockets[ON_MAINS].value > 0.0 { CHARGE } else { -DISCHARGE };
        let battery = &mut self.sockets[BATTERY].value;
        *battery = (*battery + per_s * dt).clamp(0.0, 100.0);
    }

    /// Answers a GET.
    pub fn get(&self, request: &Request) -> Answer {
        // DeviceState names its values by number: GetSwitchValue3.
        let word = request.member.trim_end_matches(|c: char| c.is_ascii_digit());
        if word == "maxswitch" {
            return Ok(json!(self.sockets.len()));
        }
        let numbered = request.member[word.len()..].parse().ok();
        let socket = &self.sockets[self.number(request, numbered)?];
        Ok(match word {
            "canasync" | "canwrite" => json!(socket.writable),
            "getswitch" => json!(socket.value > 0.0),
            "getswitchvalue" => json!(socket.value),
            "getswitchname" => json!(socket.name),
            "getswitchdescription" => json!(socket.description),
            "minswitchvalue" => json!(0.0),
            "maxswitchvalue" => json!(socket.max),
            "switchstep" => json!(1.0),
            "statechangecomplete" => json!(true),
            _ => return Err(Refusal::UnknownMember),
        })
    }

    /// Executes a PUT.
    pub fn put(&mut self, request: &Request) -> Answer {
        let known = ["setswitch", "setswitchvalue", "setasync", "setasyncvalue", "setswitchname", "cancelasync"];
        if !known.contains(&request.member.as_str()) {
            return Err(Refusal::UnknownMember);
        }
        let number = self.number(request, None)?;
        let socket = &mut self.sockets[number];
        match request.member.as_str() {
            "setswitchname" => socket.name = request.text("Name")?.to_owned(),
            "cancelasync" => {}
            _ => {
                let value = if request.member.ends_with("value") {
                    within("Value", request.number("Value")?, 0.0, socket.max)?
                } else if request.truth("State")? {
                    socket.max
                } else {
                    0.0
                };
                if !socket.writable {
                    return Err(Refusal::not_implemented("writing to this switch"));
                }
                socket.value = value;
            }
        }
        DONE
    }

    fn number(&self, request: &Request, numbered: Option<i32>) -> Result<usize, Refusal> {
        let number = numbered.map_or_else(|| request.integer("Id"), Ok)?;
        let found = usize::try_from(number).ok().filter(|number| *number < self.sockets.len());
        found.ok_or_else(|| Refusal::invalid_value(format!("there is no switch {number}")))
    }

    /// Charge and mains, for tests and people.
    pub fn state(&self) -> Value {
        json!({ "on_mains": self.sockets[ON_MAINS].value > 0.0, "battery_percent": self.sockets[BATTERY].value })
    }
}
