//! Runs the demo observatory until interrupted: `cargo run -p simulator --example simulate -- 127.0.0.1:11111 60`.

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut options = simulator::Options::default();
    if let Some(address) = arguments.next() {
        options.bind = address.parse()?;
    }
    if let Some(speed) = arguments.next() {
        options.speed = speed.parse()?;
    }
    if let Some(start) = arguments.next() {
        options.start = start.parse()?;
    }
    println!("Alpaca at http://{}/", options.bind);
    simulator::run(options, async {
        let _ = tokio::signal::ctrl_c().await;
    })
    .await?;
    Ok(())
}
