//! Reads what a device can do: properties that it may lack.

use std::time::Duration;

use contract::NoData;

use crate::client::Alpaca;
use crate::{AlpacaError, value};

/// An answer that cannot be read is asked for so often: its value holds until the device is connected anew.
const TRIES: u32 = 3;

/// A property that a device may lack: its value, or the reason why there is none. An error only if no answer comes, the
/// device is not connected, or the server answers another request.
pub async fn optional<T>(
    alpaca: &Alpaca,
    member: &str,
    read: impl Fn(&serde_json::Value) -> Result<T, NoData>,
) -> Result<Result<T, NoData>, AlpacaError> {
    let mut tries = 0;
    loop {
        tries += 1;
        let error = match alpaca.get(member).await.and_then(|answer| read(&answer).map_err(AlpacaError::Value)) {
            Ok(value) => return Ok(Ok(value)),
            Err(error) => error,
        };
        match error {
            error if error.is_transport() || error.is_not_connected() || error.is_foreign() => return Err(error),
            error if error.is_unreadable() && tries < TRIES => tokio::time::sleep(Duration::from_millis(100)).await,
            error => return Ok(Err(error.no_data())),
        }
    }
}

/// A capability flag; false where the device does not report it.
pub async fn can(alpaca: &Alpaca, member: &str) -> Result<bool, AlpacaError> {
    Ok(optional(alpaca, member, value::flag).await?.unwrap_or(false))
}
