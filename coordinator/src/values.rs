//! Reads values of the command line. Every refusal says what is wanted instead.

use std::net::SocketAddr;
use std::net::ToSocketAddrs as _;
use std::time::Duration;

use clap::ValueEnum;
use jiff::{Span, SpanRelativeTo};
use output::grouped;

/// Most workers that a configuration may have.
const MAX_WORKERS: u64 = 256;
/// Most environments that a configuration may have.
pub(crate) const MAX_ENVS: u64 = 1_000_000;
/// Largest count: floats hold all up to it exactly, and so do the integers of TOML.
pub(crate) const MAX_COUNT: u64 = 9_000_000_000_000_000;

/// Reads a whole number from `least` to `most`.
pub(crate) fn whole<T: TryFrom<u64>>(
    least: u64,
    most: u64,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let value = text.parse::<u64>().ok().filter(|value| (least..=most).contains(value));
        value.and_then(|value| T::try_from(value).ok()).ok_or_else(|| match (least, most) {
            (least, u64::MAX) => format!("wants a whole number, {least} or more"),
            (0, 1) => "wants 0 or 1".to_owned(),
            _ => format!("wants a whole number from {} to {}", grouped(least), grouped(most)),
        })
    }
}

/// A count of at least one; large ones may be written as `2e6`.
pub(crate) fn positive(text: &str) -> Result<u64, String> {
    let value = text.parse::<u64>().ok().or_else(|| {
        let value = text.parse::<f64>().ok()?;
        (value.fract() == 0.0 && (0.0..=MAX_COUNT as f64).contains(&value)).then_some(value as u64)
    });
    value.filter(|value| (1..=MAX_COUNT).contains(value)).ok_or_else(|| {
        "wants a whole number, 1 or more and at most 9e15; large ones may be written as 2e6"
            .to_owned()
    })
}

/// A number of workers that a run can begin with.
pub(crate) fn workers(text: &str) -> Result<u64, String> {
    let wanted = workers_wanted(text).ok().filter(|wanted| (1..=MAX_WORKERS).contains(wanted));
    wanted.ok_or_else(|| {
        format!("wants a whole number from 1 to {MAX_WORKERS}, or `auto` for one a processor")
    })
}

/// A number of workers that a run can begin with, or none, which leaves all work to other machines.
pub(crate) fn workers_if_any(text: &str) -> Result<u64, String> {
    let wanted = workers_wanted(text).ok().filter(|wanted| *wanted <= MAX_WORKERS);
    wanted.ok_or_else(|| {
        format!("wants a whole number from 0 to {MAX_WORKERS}, or `auto` for one a processor")
    })
}

/// A number of workers for a live run, which alone knows how many it has room for.
pub(crate) fn workers_wanted(text: &str) -> Result<u64, String> {
    if text == "auto" {
        return Ok(std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as u64);
    }
    text.parse().map_err(|_| "wants a whole number, or `auto` for one a processor".to_owned())
}

/// An address with a port, or the name of a machine in the place of the address.
pub(crate) fn address(text: &str) -> Result<SocketAddr, String> {
    addresses(text).map(|found| preferred(&found))
}

/// The one of some addresses, at least one, that stands for all: most names of this machine have an address of either kind, and clients try the older one.
pub(crate) fn preferred(addresses: &[SocketAddr]) -> SocketAddr {
    *addresses.iter().find(|address| address.is_ipv4()).unwrap_or(&addresses[0])
}

/// All addresses of a name, at least one, or the one that is given.
pub(crate) fn addresses(text: &str) -> Result<Vec<SocketAddr>, String> {
    if let Ok(address) = text.parse() {
        return Ok(vec![address]);
    }
    let wanted = "wants an address with a port, such as 127.0.0.1:8270 or localhost:8270";
    let named = text.rsplit_once(':').filter(|(name, port)| {
        // A name that is empty would be resolved, too, and an address of IPv6 stands in brackets.
        !name.is_empty() && !name.contains(':') && port.parse::<u16>().is_ok()
    });
    if named.is_none() {
        return Err(wanted.to_owned());
    }
    let found: Vec<SocketAddr> = match text.to_socket_addrs() {
        Ok(found) => found.collect(),
        Err(error) => return Err(format!("{wanted}; {text} cannot be resolved: {error}")),
    };
    if found.is_empty() {
        return Err(format!("{wanted}; {text} has no address"));
    }
    Ok(found)
}

/// Where to listen, if anywhere.
pub(crate) fn listen(text: &str) -> Result<Listen, String> {
    if text == "off" {
        return Ok(Listen::Off);
    }
    address(text).map(Listen::At).map_err(|wanted| format!("{wanted}, or `off`"))
}

/// A key of the configuration and its value, still together.
pub(crate) fn assignment(text: &str) -> Result<String, String> {
    match text.split_once('=') {
        Some((key, _)) if !key.trim().is_empty() => Ok(text.to_owned()),
        _ => Err("wants KEY=VALUE, such as algorithm.gamma=0.97".to_owned()),
    }
}

/// A bare number of seconds.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "wants a number of seconds, such as 0.01".to_owned())
}

/// A number that is not negative.
pub(crate) fn amount(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| *value >= 0.0 && value.is_finite());
    value.ok_or_else(|| "wants a number, 0 or more".to_owned())
}

/// A number that is positive.
pub(crate) fn above_zero(text: &str) -> Result<f64, String> {
    amount(text)
        .ok()
        .filter(|value| *value > 0.0)
        .ok_or_else(|| "wants a number above 0".to_owned())
}

/// Numbers that are not negative, with commas between them.
pub(crate) fn amounts(text: &str) -> Result<Amounts, String> {
    let values: Result<Vec<f64>, String> = text.split(',').map(amount).collect();
    values.map(Amounts).map_err(|_| "wants numbers, 0 or more, such as 0,0.5,1".to_owned())
}

/// Numbers that are positive, with commas between them.
pub(crate) fn all_above_zero(text: &str) -> Result<Amounts, String> {
    let values: Result<Vec<f64>, String> = text.split(',').map(above_zero).collect();
    values.map(Amounts).map_err(|_| "wants numbers above 0, such as 0.5,1,2".to_owned())
}

/// How long to measure, in seconds.
pub(crate) fn measuring_time(text: &str) -> Result<f64, String> {
    let wanted = "wants a number of seconds above 0 and at most 3600, such as 5";
    let seconds = text.parse().ok().filter(|s: &f64| *s > 0.0 && *s <= 3600.0);
    seconds.ok_or_else(|| wanted.to_owned())
}

/// A time with units, as [`jiff::Span`] reads it; a bare number is in seconds.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    let wrong = || "wants a time such as 90s, 10m or 1h30m".to_owned();
    let time = match text.parse::<u32>() {
        Ok(seconds) => Duration::from_secs(seconds.into()),
        Err(_) => text
            .parse::<Span>()
            .and_then(|span| span.to_duration(SpanRelativeTo::days_are_24_hours()))
            .and_then(Duration::try_from)
            .map_err(|_| wrong())?,
    };
    if (1e-3..1e9).contains(&time.as_secs_f64()) {
        Ok(time)
    } else {
        Err("wants more than nothing and less than 30 years".to_owned())
    }
}

/// On or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    /// On.
    On,
    /// Off.
    Off,
}

/// Several numbers, zero or more each.
#[derive(Debug, Clone, PartialEq)]
pub struct Amounts(pub Vec<f64>);

/// Where to listen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listen {
    /// Nowhere.
    Off,
    /// There.
    At(std::net::SocketAddr),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_counts() {
        let seconds = |text| duration(text).map(|time| time.as_secs_f64());
        assert_eq!(seconds("10m"), Ok(600.0));
        assert_eq!(seconds("1h30m"), Ok(5400.0));
        assert_eq!(seconds("1.5s"), Ok(1.5));
        assert_eq!(seconds("90"), Ok(90.0));
        assert_eq!(seconds("2d 30 min"), Ok(174_600.0));
        for wrong in ["", "m", "10x", "0", "-3s", "3s ago", "1e400s", "10m5", "1y", "9999999d"] {
            assert!(duration(wrong).is_err(), "{wrong}");
        }
        assert_eq!(positive("2e6"), Ok(2_000_000));
        assert_eq!(positive("9e15"), positive("9000000000000000"));
        for wrong in ["0", "-1", "1.5", "nan", "inf", "many", "1e16", "18446744073709551615"] {
            assert!(positive(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn whole_numbers_say_their_range() {
        assert_eq!(whole::<u32>(1, 1_000_000)("30"), Ok(30));
        let wanted = "wants a whole number from 1 to 1,000,000";
        for wrong in ["0", "-1", "1000001", "1.5", "abc", ""] {
            assert_eq!(whole::<u32>(1, 1_000_000)(wrong), Err(wanted.to_owned()), "{wrong}");
        }
        let wanted = "wants a whole number, 1 or more";
        assert_eq!(whole::<u64>(1, u64::MAX)("0"), Err(wanted.to_owned()));
        assert_eq!(whole::<u64>(0, 1)("2"), Err("wants 0 or 1".to_owned()));
    }

    #[test]
    fn workers_are_a_number_or_auto() {
        assert_eq!(workers("4"), Ok(4));
        assert!(workers("auto").is_ok_and(|workers| workers >= 1));
        for wrong in ["0", "257", "-1", "all"] {
            assert!(workers(wrong).is_err_and(|wanted| wanted.contains("1 to 256")), "{wrong}");
        }
        assert_eq!(workers_if_any("0"), Ok(0));
        for wrong in ["257", "-1", "all"] {
            let refused = workers_if_any(wrong);
            assert!(refused.is_err_and(|wanted| wanted.contains("0 to 256")), "{wrong}");
        }
        assert_eq!(workers_wanted("0"), Ok(0), "the run says how many it can have");
        assert!(workers_wanted("-1").is_err());
    }

    #[test]
    fn measuring_takes_some_time_but_not_forever() {
        assert_eq!(measuring_time("0.05"), Ok(0.05));
        for wrong in ["0", "-1", "nan", "inf", "5s", "3601", ""] {
            assert!(
                measuring_time(wrong).is_err_and(|wanted| wanted.contains("above 0")),
                "{wrong}"
            );
        }
    }

    #[test]
    fn addresses_have_a_port() {
        assert_eq!(listen("off"), Ok(Listen::Off));
        assert!(address("127.0.0.1:0").is_ok() && address("[::1]:80").is_ok());
        for wrong in ["foo", ":80", "127.0.0.1", "off", "::1", "localhost:http", "localhost:70000"]
        {
            assert!(address(wrong).is_err_and(|wanted| wanted.contains(":8270")), "{wrong}");
        }
    }

    #[test]
    fn a_machine_may_be_named() {
        let found = address("localhost:8270").expect("every machine has this name");
        assert!(found.ip().is_loopback() && found.port() == 8270, "{found}");
        assert_eq!(listen("localhost:8270"), Ok(Listen::At(found)));
        let unknown = address("no-such-machine.invalid:80").expect_err("reserved for no machine");
        assert!(unknown.contains("no-such-machine.invalid:80 cannot be resolved"), "{unknown}");
    }
}
