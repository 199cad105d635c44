//! Several machines on one: network namespaces, joined by a bridge.
//!
//! Machine 0 has the address 10.231.7.1, machine 1 10.231.7.2, and so on. Each has its own link to the bridge, which can be
//! made slow, lossy or narrow, and cut. Nothing of it reaches the networks of the real machine.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::{Owned, crosscheck, python};

/// See the module. All of it goes away with this value.
#[derive(Debug)]
pub struct Network {
    /// Of this process, so that several may be there at a time.
    id: String,
    machines: usize,
    /// Cables that are not as fast as the machine.
    wires: BTreeMap<usize, Owned>,
}

/// What a cable is like, both ways.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cable {
    /// Milliseconds that a frame takes.
    pub delay_ms: f64,
    /// Percent of the frames that are lost.
    pub loss: f64,
    /// Mbit/s that it carries; 0 for as much as comes.
    pub mbit: f64,
}

impl Network {
    /// `None` where namespaces may not be made, or `ip` is not there.
    pub fn new(machines: usize) -> Option<Self> {
        static MADE: AtomicU32 = AtomicU32::new(0);
        let id = format!("{}-{}", std::process::id(), MADE.fetch_add(1, Ordering::Relaxed));
        let network = Self { id, machines, wires: BTreeMap::new() };
        let switch = network.switch();
        let mut lines = vec![
            format!("netns add {switch}"),
            format!("-n {switch} link add bridge type bridge"),
            format!("-n {switch} link set bridge up"),
        ];
        for machine in 0..machines {
            let name = network.machine(machine);
            lines.extend([
                format!("netns add {name}"),
                format!("-n {switch} link add port{machine} type veth peer name eth0 netns {name}"),
                format!("-n {switch} link set port{machine} master bridge"),
                format!("-n {switch} link set port{machine} up"),
                format!("-n {name} addr add {}/24 dev eth0", Self::address(machine)),
                format!("-n {name} link set lo up"),
                format!("-n {name} link set eth0 up"),
            ]);
        }
        let made = lines.iter().all(|line| ip(line));
        made.then_some(network)
    }

    /// Where a machine is.
    pub fn address(machine: usize) -> String {
        format!("10.231.7.{}", machine + 1)
    }

    /// Where the run of machine 0 waits for others.
    pub fn endpoint() -> String {
        format!("tcp/{}:7447", Self::address(0))
    }

    /// What starts programs on a machine, before their names.
    pub fn on(&self, machine: usize) -> [String; 4] {
        ["ip", "netns", "exec", &self.machine(machine)].map(ToOwned::to_owned)
    }

    /// Gives a machine another cable. Whatever is on its way is lost.
    pub fn cable(&mut self, machine: usize, cable: Cable) {
        let (switch, name) = (self.switch(), self.machine(machine));
        let port = format!("port{machine}");
        self.wires.remove(&machine);
        // A pair goes away with one of its ends; the devices of a wire have gone with it.
        ip(&format!("-n {switch} link del {port}"));
        let Cable { delay_ms, loss, mbit } = cable;
        let mut command = Command::new(python());
        command.arg(crosscheck("wire.py")).args([&switch, &port, &name, "eth0"]);
        command.args([delay_ms, loss, mbit].map(|number| number.to_string()));
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut wire = Owned::spawn(&mut command);
        let mut said = String::new();
        let out = wire.stdout().expect("piped");
        BufReader::new(out).read_line(&mut said).expect("it speaks");
        assert_eq!(said, "there\n");
        for line in [
            format!("-n {switch} link set {port} master bridge"),
            format!("-n {switch} link set {port} up"),
            format!("-n {name} addr add {}/24 dev eth0", Self::address(machine)),
            format!("-n {name} link set eth0 up"),
        ] {
            assert!(ip(&line), "{line}");
        }
        self.wires.insert(machine, wire);
    }

    /// Pulls a machine's cable, or plugs it in.
    pub fn link(&self, machine: usize, up: bool) {
        let state = if up { "up" } else { "down" };
        assert!(ip(&format!("-n {} link set port{machine} {state}", self.switch())));
    }

    /// From now on two machines do not reach each other.
    pub fn part(&self, one: usize, other: usize) {
        for (here, there) in [(one, other), (other, one)] {
            let (name, address) = (self.machine(here), Self::address(there));
            assert!(ip(&format!("-n {name} route add blackhole {address}/32")));
        }
    }

    fn switch(&self) -> String {
        format!("octopus-{}-switch", self.id)
    }

    fn machine(&self, machine: usize) -> String {
        format!("octopus-{}-{machine}", self.id)
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for machine in 0..self.machines {
            ip(&format!("netns del {}", self.machine(machine)));
        }
        ip(&format!("netns del {}", self.switch()));
    }
}

/// Whether `ip` did it.
fn ip(line: &str) -> bool {
    let mut command = Command::new("ip");
    command.args(line.split(' ')).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}
