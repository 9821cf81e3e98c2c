//! A camera's image as it comes over the wire.

use reqwest::Response;
use reqwest::header::CONTENT_TYPE;

use crate::body::read_capped;
use crate::image::Image;
use crate::image_bytes::{self, Header};
use crate::transaction::{Echo, Transactions};
use crate::{AlpacaError, image_json, response};

/// An image as the camera sent it, checked as far as is quick.
#[derive(Debug)]
pub enum RawImage {
    /// ImageBytes: a binary header and column-wise elements.
    Binary {
        /// Its header.
        header: Header,
        /// The whole body, header included.
        body: Vec<u8>,
    },
    /// JSON `imagearray`.
    Json(Vec<u8>),
}

impl RawImage {
    /// Receives the answer to request `asked` for `imagearray`.
    pub(crate) async fn receive(
        mut response: Response,
        pixels: u64,
        transactions: &Transactions,
        asked: u32,
    ) -> Result<Self, AlpacaError> {
        let status = response.status().as_u16();
        let kind = response.headers().get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
        if !kind.to_ascii_lowercase().contains("imagebytes") || status != 200 {
            // Three colours of 25 digits and commas each, as doubles have, and room for an error in words.
            let cap = usize::try_from(pixels.saturating_mul(75)).unwrap_or(usize::MAX).clamp(1 << 20, 4 << 30);
            let body = read_capped(response, cap).await?;
            if status != 200 || body.len() < 4096 {
                // An error, or an image so small that reading it twice costs nothing.
                response::parse(status, &body, transactions, asked)?;
            }
            return Ok(Self::Json(body));
        }
        let mut body = Vec::new();
        let mut header = None;
        while let Some(chunk) = response.chunk().await.map_err(|error| AlpacaError::from_http(&error))? {
            body.extend_from_slice(&chunk);
            if header.is_none() && body.len() >= image_bytes::HEADER {
                let read = Header::read(&body).map_err(AlpacaError::Protocol)?;
                transactions.check(asked, &Echo::Number(i64::from(read.client_transaction)))?;
                body.reserve_exact(read.bytes().saturating_sub(body.len()));
                header = Some(read);
            }
            let cap = header.as_ref().map_or(1 << 20, Header::bytes) + (64 << 10);
            if body.len() > cap {
                return Err(AlpacaError::Protocol(format!("the image is longer than its header says, {cap} bytes")));
            }
        }
        let header = header.ok_or_else(|| AlpacaError::Protocol("the image ends within its header".to_owned()))?;
        if header.error_number != 0 {
            return Err(header.error(&body));
        }
        if body.len() < header.bytes() {
            let (have, want) = (body.len(), header.bytes());
            return Err(AlpacaError::Protocol(format!("the image has {have} of {want} bytes")));
        }
        Ok(Self::Binary { header, body })
    }

    /// Columns and rows, where they are known before decoding.
    pub fn size_px(&self) -> Option<(u32, u32)> {
        match self {
            Self::Binary { header, .. } => Some(header.size_px()),
            Self::Json(_) => None,
        }
    }

    /// Turns it into rows; heavy, so not for an async thread. `max_adu` decides whether 16 bits are enough.
    pub fn into_image(self, max_adu: Option<f64>) -> Result<Image, AlpacaError> {
        match self {
            Self::Binary { header, body } => image_bytes::decode(&header, &body, max_adu),
            Self::Json(body) => image_json::decode(&body, max_adu),
        }
        .map_err(AlpacaError::Protocol)
    }
}
