//! Reads what a device can do: properties that it may lack, each known, denied, or not read yet.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use contract::NoData;
use serde_json::Value;

use crate::client::Alpaca;
use crate::{AlpacaError, value};

/// A property that cannot be read is asked for so often in one pass.
const TRIES: u32 = 3;

/// What a device can do, as far as it was read since it was connected. A property that the device has answered, or has
/// denied to have, is not asked for again; one that could not be read is, in every further pass.
pub struct Abilities {
    alpaca: Alpaca,
    /// The answers, by property and parameters.
    known: BTreeMap<String, Value>,
    /// What the device does not have.
    denied: BTreeSet<String>,
    unread: BTreeMap<String, NoData>,
}

impl Abilities {
    /// Those of a device of which nothing was read yet.
    pub fn of(alpaca: Alpaca) -> Self {
        Self { alpaca, known: BTreeMap::new(), denied: BTreeSet::new(), unread: BTreeMap::new() }
    }

    /// What could not be read so far, with the reason of the last try.
    pub fn unread(&self) -> &BTreeMap<String, NoData> {
        &self.unread
    }

    /// A property that a device may lack: its value, or the reason why there is none. An error only if no answer comes,
    /// the device is not connected, or the server answers another request.
    pub async fn read<T>(
        &mut self,
        property: &str,
        read: impl Fn(&Value) -> Result<T, NoData>,
    ) -> Result<Result<T, NoData>, AlpacaError> {
        self.read_of(property, None, read).await
    }

    /// As [`Self::read`], of a property with a number, such as that of a switch.
    pub async fn read_of<T>(
        &mut self,
        property: &str,
        number: Option<i64>,
        read: impl Fn(&Value) -> Result<T, NoData>,
    ) -> Result<Result<T, NoData>, AlpacaError> {
        let key = number.map_or_else(|| property.to_owned(), |number| format!("{property}({number})"));
        if self.denied.contains(&key) {
            return Ok(Err(NoData::not_implemented()));
        }
        if let Some(value) = self.known.get(&key).and_then(|answer| read(answer).ok()) {
            return Ok(Ok(value));
        }
        let member = property.to_ascii_lowercase();
        let id = number.map(|number| number.to_string());
        let parameters: Vec<(&str, &str)> = id.iter().map(|id| ("Id", id.as_str())).collect();
        let mut tries = 0;
        loop {
            tries += 1;
            let error = match self.alpaca.get_with(&member, &parameters).await {
                Ok(answer) => match read(&answer) {
                    Ok(value) => {
                        self.unread.remove(&key);
                        self.known.insert(key, answer);
                        return Ok(Ok(value));
                    }
                    Err(reason) => AlpacaError::Value(reason),
                },
                Err(error) => error,
            };
            match error {
                error if error.is_transport() || error.is_not_connected() || error.is_foreign() => return Err(error),
                error if error.is_not_implemented() => {
                    self.unread.remove(&key);
                    self.denied.insert(key);
                    return Ok(Err(error.no_data()));
                }
                _ if tries < TRIES => tokio::time::sleep(Duration::from_millis(100)).await,
                error => {
                    self.unread.insert(key, error.no_data());
                    return Ok(Err(error.no_data()));
                }
            }
        }
    }

    /// What the device answered cannot be, as other answers of it show: it counts as not read, and is asked for again.
    pub fn doubt(&mut self, property: &str, why: &NoData) {
        self.known.remove(property);
        self.unread.insert(property.to_owned(), why.clone());
    }

    /// A capability flag: false only where the device answers so, or does not have the property. Where it could not be
    /// read it is true, so that the device itself decides when it is asked to do it.
    pub async fn can(&mut self, property: &str) -> Result<bool, AlpacaError> {
        let answer = self.read(property, value::flag).await?;
        Ok(answer.unwrap_or(!self.denied.contains(property)))
    }
}
