//! An HTTP server, with TLS or without, that remembers its requests.

use std::convert::Infallible;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use http_body_util::{BodyExt as _, Full};
use hyper::body::Incoming;
use hyper::service::service_fn;
use hyper::{Request, Response};
use hyper_util::rt::TokioIo;
use rustls::ServerConfig;
use serde_json::Value;
use tokio::net::TcpListener;
use tokio_rustls::TlsAcceptor;

#[derive(Debug, Clone)]
pub struct Asked {
    pub method: String,
    pub path: String,
    pub authorization: String,
    pub body: Value,
}

#[derive(Clone)]
pub struct Web {
    pub port: u16,
    asked: Arc<Mutex<Vec<Asked>>>,
    connections: Arc<AtomicUsize>,
}

impl Web {
    pub async fn serve(tls: Option<Arc<ServerConfig>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let web =
            Self { port: listener.local_addr().unwrap().port(), asked: Arc::default(), connections: Arc::default() };
        let (asked, connections) = (web.asked.clone(), web.connections.clone());
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                connections.fetch_add(1, Ordering::Relaxed);
                let (asked, tls) = (asked.clone(), tls.clone());
                tokio::spawn(async move {
                    let service = service_fn(move |request| remember(request, asked.clone()));
                    let http = hyper::server::conn::http1::Builder::new();
                    // A client that refuses the certificate leaves, and the tests are about that.
                    let _ = match tls {
                        Some(tls) => match TlsAcceptor::from(tls).accept(stream).await {
                            Ok(stream) => http.serve_connection(TokioIo::new(stream), service).await,
                            Err(_) => Ok(()),
                        },
                        None => http.serve_connection(TokioIo::new(stream), service).await,
                    };
                });
            }
        });
        web
    }

    pub fn asked(&self) -> Vec<Asked> {
        self.asked.lock().unwrap().clone()
    }

    pub fn connections(&self) -> usize {
        self.connections.load(Ordering::Relaxed)
    }

    /// How often it received this event of this alert.
    pub fn count(&self, event: &str, id: &str) -> usize {
        let asked = self.asked();
        let news = asked.iter().flat_map(|asked| asked.body["news"].as_array().cloned().unwrap_or_default());
        news.filter(|news| news["event"] == event && news["alert"]["id"] == id).count()
    }
}

async fn remember(
    request: Request<Incoming>,
    asked: Arc<Mutex<Vec<Asked>>>,
) -> Result<Response<Full<Bytes>>, Infallible> {
    let header =
        |name: &str| request.headers().get(name).and_then(|value| value.to_str().ok()).unwrap_or("").to_owned();
    let authorization = header("authorization");
    let (method, path) = (request.method().to_string(), request.uri().path().to_owned());
    let body = request.into_body().collect().await.map(|body| body.to_bytes()).unwrap_or_default();
    let body = serde_json::from_slice(&body).unwrap_or_default();
    asked.lock().unwrap().push(Asked { method, path, authorization, body });
    Ok(Response::new(Full::new(Bytes::from("thanks"))))
}
