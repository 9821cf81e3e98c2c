//! Reads the body of an answer up to a limit.

use reqwest::Response;

use crate::AlpacaError;

/// Largest JSON answer that is no image.
pub(crate) const JSON_CAP: usize = 1 << 20;

/// Reads a body of at most `cap` bytes.
pub(crate) async fn read_capped(mut response: Response, cap: usize) -> Result<Vec<u8>, AlpacaError> {
    let mut body = Vec::new();
    while let Some(chunk) = response.chunk().await.map_err(|error| AlpacaError::from_http(&error))? {
        if body.len() + chunk.len() > cap {
            return Err(AlpacaError::Protocol(format!("the answer is longer than {cap} bytes")));
        }
        body.extend_from_slice(&chunk);
    }
    Ok(body)
}
