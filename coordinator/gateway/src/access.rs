//! Who may say what in the network of a run whose hosts have certificates.
//!
//! The network looks at the name in the certificate of a link, and at the key of every message that comes or goes: below
//! a host's name there is only what that host says and hears. So no host can answer for another one, take its orders or
//! tell others that the run is over. Names that are not in the list get one answer: that they are not.

use serde_json::{Value, json};

/// The rules for hosts of these names, as the network's configuration has them.
pub(crate) fn rules(hosts: &[String]) -> Value {
    let mut rules = vec![
        rule("asks for policies", &["query", "reply"], &BOTH, &["octopus/*/policy/*"]),
        rule("hears the hub", &["declare_subscriber"], &["ingress"], &["octopus/beat"]),
        rule("is told by the hub", &["put"], &["egress"], &["octopus/beat"]),
        rule(
            "sees whom to ask",
            &["declare_queryable"],
            &["egress"],
            &["octopus/hello/*", "octopus/*/policy/*"],
        ),
        rule(
            "sees who listens",
            &["declare_subscriber", "declare_liveliness_subscriber"],
            &["egress"],
            &["octopus/*/host/*/*/beat", "octopus/*/host/*/*/alive"],
        ),
        rule("asks why", &["query", "reply"], &BOTH, &["octopus/stranger/*"]),
        rule("sees whom to ask why", &["declare_queryable"], &["egress"], &["octopus/stranger/*"]),
    ];
    // Who has no name in the list, and, by its lack of conditions, everybody.
    let mut subjects = vec![json!({ "id": ANYBODY })];
    let mut policies =
        vec![json!({ "rules": ["asks why", "sees whom to ask why"], "subjects": [ANYBODY] })];
    for host in hosts {
        let own = format!("is {host}");
        let below = [format!("octopus/hello/{host}"), format!("octopus/*/host/{host}/**")];
        rules.push(rule(&own, &ALL, &BOTH, &[&below[0], &below[1]]));
        subjects.push(json!({ "id": own, "cert_common_names": [host] }));
        policies.push(json!({
            "rules": [
                own,
                "asks for policies",
                "hears the hub",
                "is told by the hub",
                "sees whom to ask",
                "sees who listens",
            ],
            "subjects": [own],
        }));
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}

const ANYBODY: &str = "anybody";
const BOTH: [&str; 2] = ["ingress", "egress"];
const ALL: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

fn rule(id: &str, messages: &[&str], flows: &[&str], keys: &[&str]) -> Value {
    json!({ "id": id, "messages": messages, "flows": flows, "permission": "allow", "key_exprs": keys })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_has_its_own_name_alone() {
        let rules = rules(&["lab-2".to_owned(), "lab-3".to_owned()]);
        assert_eq!(rules["default_permission"], "deny");
        let policies = rules["policies"].as_array().expect("policies");
        assert_eq!(policies.len(), 3);
        let subject = |at: usize| &rules["subjects"][at];
        assert_eq!(subject(0).as_object().expect("a subject").len(), 1, "anybody");
        assert_eq!(subject(1)["cert_common_names"], json!(["lab-2"]));
        let named = |policy: &Value| policy["rules"].to_string().contains("is lab-2");
        assert_eq!(policies.iter().filter(|policy| named(policy)).count(), 1);
    }

    #[test]
    fn nobody_speaks_for_the_hub() {
        let rules = rules(&["lab".to_owned()]);
        for rule in rules["rules"].as_array().expect("rules") {
            let says = rule["messages"].to_string().contains("put");
            let comes = rule["flows"].to_string().contains("ingress");
            let hub = rule["key_exprs"].to_string().contains("octopus/beat");
            assert!(!(says && comes && hub), "{rule}");
        }
    }
}
