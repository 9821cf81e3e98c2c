//! A guard's request to close, as calls of the dome's server.

use alpaca::{Alpaca, AlpacaError};
use interlock::{Answer, Request};

/// Sends it; `connect`: a device that is not connected is connected first, because it was restarted and nobody has
/// noticed yet.
pub async fn send(alpaca: &Alpaca, request: Request, connect: bool) -> Result<(), AlpacaError> {
    if request == Request::AbortThenClose {
        // Closing follows whether it stopped or not.
        let _ = alpaca.put("abortslew", &[]).await;
    }
    put(alpaca, connect, "closeshutter").await
}

/// A call that moves something; `connect` as above.
pub async fn put(alpaca: &Alpaca, connect: bool, member: &str) -> Result<(), AlpacaError> {
    match alpaca.put(member, &[]).await {
        Err(error) if connect && error.is_not_connected() => {
            // The second try shows whether it connected.
            let _ = alpaca.put("connected", &[("Connected", "True")]).await;
            alpaca.put(member, &[]).await
        }
        answered => answered,
    }
}

/// What a request has come to. Without an answer it may have arrived all the same.
pub fn answer_of(result: &Result<(), AlpacaError>) -> Answer {
    match result {
        Ok(()) => Answer::Accepted,
        Err(error) if error.is_unknown_outcome() => Answer::Unknown,
        Err(_) => Answer::Refused,
    }
}
