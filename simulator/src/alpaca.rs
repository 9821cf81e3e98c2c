//! The Alpaca protocol: `/api/v1/{kind}/{number}/{member}` in, ASCOM's JSON or ImageBytes out.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::{ConnectInfo, Path, RawQuery, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::Response;
use serde_json::{Value, json};

use crate::answer::{Answer, Refusal};
use crate::connection::Scissors;
use crate::faults::{spell_nan, with_nan};
use crate::frame::image_bytes_error;
use crate::kind::Kind;
use crate::request::Request;
use crate::telescope::WAITS_FOR_SLEW;
use crate::world::{Reply, World, error_number};

/// Answers a request to a device.
pub async fn device(
    State(world): State<Arc<World>>,
    ConnectInfo(scissors): ConnectInfo<Scissors>,
    Path((kind, number, member)): Path<(String, String, String)>,
    RawQuery(query): RawQuery,
    method: Method,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    let Some(kind) = Kind::at(&kind, &number).filter(|kind| world.kinds().contains(kind)) else {
        return text(StatusCode::BAD_REQUEST, format!("there is no device {kind} {number}"));
    };
    let is_put = method == Method::PUT;
    if !is_put && method != Method::GET {
        return text(StatusCode::METHOD_NOT_ALLOWED, "only GET and PUT".to_owned());
    }
    let encoded = if is_put { String::from_utf8_lossy(&body).into_owned() } else { query.unwrap_or_default() };
    let request = Request::new(is_put, &member, &encoded);
    world.advance();
    if !is_put && is_camera(kind) && matches!(member.as_str(), "imagearray" | "imagearrayvariant") {
        return image(&world, kind, &scissors, &request, &headers).await;
    }
    let reply = world.ask(kind, &request);
    if is_put && reply.answer.is_ok() {
        follow_up(&world, kind, &member).await;
    }
    if let Some(spoilt) = spoil(&reply, &scissors).await {
        return spoilt;
    }
    let answer = if reply.fault.nan { reply.answer.map(with_nan) } else { reply.answer };
    answered(answer, request.client_transaction(), world.next_transaction())
}

fn is_camera(kind: Kind) -> bool {
    matches!(kind, Kind::Camera | Kind::GuideCamera)
}

/// The wait that a command still needs: old-fashioned methods answer when they are done, and a method that takes an
/// exposure waits for it.
async fn follow_up(world: &Arc<World>, kind: Kind, member: &str) {
    if kind == Kind::Telescope && WAITS_FOR_SLEW.contains(&member) {
        while world.is_slewing() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
    if is_camera(kind) && matches!(member, "startexposure" | "stopexposure") {
        let end = world.exposure_ends(kind);
        let world = world.clone();
        tokio::spawn(async move {
            let wait_s = end.map_or(0.0, |end| end.seconds_since(world.now()).max(0.0));
            tokio::time::sleep(world.clock().machine_for(wait_s) + Duration::from_millis(1)).await;
            world.advance();
        });
    }
}

/// The ways a fault can keep an answer from the client, or delay it.
async fn spoil(reply: &Reply, scissors: &Scissors) -> Option<Response> {
    let fault = &reply.fault;
    if fault.slow_ms > 0 {
        tokio::time::sleep(Duration::from_millis(fault.slow_ms)).await;
    }
    if fault.hang {
        // Until the client gives up; the end of its connection drops this future.
        std::future::pending::<()>().await;
    }
    if fault.refuse || fault.mute {
        scissors.cut();
        return Some(text(StatusCode::INTERNAL_SERVER_ERROR, String::new()));
    }
    fault.html.then(|| {
        let page =
            "<!DOCTYPE html><html><head><title>500</title></head><body><h1>Internal Server Error</h1></body></html>";
        let mut response = text(StatusCode::INTERNAL_SERVER_ERROR, page.to_owned());
        response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("text/html; charset=utf-8"));
        response
    })
}

/// The image, in the form that the client accepts.
async fn image(
    world: &Arc<World>,
    kind: Kind,
    scissors: &Scissors,
    request: &Request,
    headers: &HeaderMap,
) -> Response {
    let reply = world.ask(kind, request);
    if let Some(spoilt) = spoil(&reply, scissors).await {
        return spoilt;
    }
    let (client, server) = (request.client_transaction(), world.next_transaction());
    let frame = reply.answer.and_then(|_| world.image(kind));
    let accepts = headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok()).unwrap_or_default();
    if accepts.to_ascii_lowercase().contains("application/imagebytes") {
        let bytes = match frame {
            Ok(frame) => frame.image_bytes(client, server),
            Err(refusal) => {
                let (code, message) = number_and_text(refusal);
                image_bytes_error(code, &message, client, server)
            }
        };
        return with_type("application/imagebytes", bytes);
    }
    let frame = match frame {
        Ok(frame) => frame,
        Err(refusal) => return answered(Err(refusal), client, server),
    };
    let drawn = tokio::task::spawn_blocking(move || {
        format!(
            "{{\"Type\":2,\"Rank\":2,\"Value\":{},\"ClientTransactionID\":{client},\"ServerTransactionID\":{server},\
             \"ErrorNumber\":0,\"ErrorMessage\":\"\"}}",
            frame.json()
        )
    });
    with_type("application/json; charset=utf-8", drawn.await.unwrap_or_default().into_bytes())
}

/// ASCOM's JSON envelope, or HTTP 400 for a request that makes no sense.
fn answered(answer: Answer, client: u32, server: u32) -> Response {
    let number = error_number(&answer);
    let mut envelope = json!({});
    match answer {
        Ok(Value::Null) => {}
        Ok(value) => envelope["Value"] = value,
        Err(Refusal::BadRequest(message)) => return text(StatusCode::BAD_REQUEST, message),
        Err(Refusal::UnknownMember) => return text(StatusCode::BAD_REQUEST, "there is no such member".to_owned()),
        Err(Refusal::Ascom { message, .. }) => envelope["ErrorMessage"] = Value::from(message),
    }
    envelope["ClientTransactionID"] = Value::from(client);
    envelope["ServerTransactionID"] = Value::from(server);
    envelope["ErrorNumber"] = Value::from(number);
    if number == 0 {
        envelope["ErrorMessage"] = Value::from("");
    }
    with_type("application/json; charset=utf-8", spell_nan(envelope.to_string()).into_bytes())
}

fn number_and_text(refusal: Refusal) -> (i32, String) {
    match refusal {
        Refusal::Ascom { code, message } => (code, message),
        Refusal::BadRequest(message) => (0x401, message),
        Refusal::UnknownMember => (0x400, "there is no such member".to_owned()),
    }
}

fn with_type(content_type: &'static str, bytes: Vec<u8>) -> Response {
    let mut response = Response::new(Body::from(bytes));
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(content_type));
    response
}

/// A plain text answer.
pub fn text(status: StatusCode, text: String) -> Response {
    let mut response = with_type("text/plain; charset=utf-8", text.into_bytes());
    *response.status_mut() = status;
    response
}
