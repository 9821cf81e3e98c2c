//! HTTP servers of tests.

use std::net::SocketAddr;

use axum::Router;

/// Serves these routes on a free port of the loopback interface until the runtime ends.
pub async fn serve(routes: Router) -> SocketAddr {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(async move { axum::serve(listener, routes).await });
    address
}
