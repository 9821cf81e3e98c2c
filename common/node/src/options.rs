//! The command line of a node.

use std::path::PathBuf;

use clap::Parser;
use contract::Name;

/// What a node's command line takes.
#[derive(Debug, Clone, Parser)]
#[command(version)]
pub struct NodeOptions {
    /// The telescope's observatory.toml.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// This node's name; needed where several nodes of one role serve one telescope. Where absent: `main`; all device
    /// nodes of the file, each as a process of its own, for the role `device`.
    #[arg(long)]
    pub id: Option<Name>,
    /// Prove the configuration and stop.
    #[arg(long)]
    pub check: bool,
    /// Listen here instead of where the configuration says, such as tcp/127.0.0.1:7447.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Meet this peer, in addition to those of the configuration.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Do not look for peers by multicast, whatever the configuration says.
    #[arg(long)]
    pub no_multicast: bool,
    /// Stop when standard input closes, that is when the parent process ends.
    #[arg(long)]
    pub with_parent: bool,
    /// This device node has a guard process around it, which alone sets this.
    #[arg(long, hide = true)]
    pub guarded: bool,
}
