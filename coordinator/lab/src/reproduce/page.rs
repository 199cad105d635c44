//! The page: claims, figures, and where every number comes from. It stands alone: no script, nothing fetched.

use maud::{Markup, PreEscaped, html};
use output::grouped;
use simulator::robot::Robot;

use super::claims::{Claim, Tally, verdict};
use super::episodes::Links;
use super::reports::Reports;
use super::{drawing, figures};
use crate::document::{document, made};
use crate::experiments::report::{Goals, Report};
use crate::experiments::{Experiment, Name, ReportOf};
use crate::experiments::{arm_failure, base_mass, disturbance, noise, precision, reassembly};
use crate::figures::families::{Family, Over, families};
use crate::figures::learning::learning as learning_curves;
use crate::figures::recorded::Recorded;
use crate::identity::Identity;

/// Stands in every page of ours, and so in none of others.
pub(super) const GENERATOR: &str = "octopus reproduce";

/// What the page shows.
pub(super) struct Content<'a> {
    pub(super) reports: &'a Reports,
    pub(super) claims: &'a [Claim],
    /// The command behind each experiment.
    pub(super) commands: &'a [(Name, String)],
    /// Of the trainings.
    pub(super) curves: &'a [Recorded],
    pub(super) robot: &'a Robot,
    /// Into the file beside it that plays episodes; none where there is none.
    pub(super) links: &'a Links,
    pub(super) quick: bool,
}

/// The page as HTML.
pub(super) fn page(content: &Content<'_>) -> anyhow::Result<String> {
    let Content { reports, links, .. } = content;
    let sections = [
        precision(content)?,
        disturbance(content)?,
        section::<arm_failure::Study>(
            content,
            "One arm failed",
            &reports.arm_failure,
            &html! {
                (figure(&figures::arm_failure(reports, links)?, "The base is turned while an arm is held by its servos or gives no torque, from the beginning. Left \
                    one episode with the authors' goal, then all held-out goals."))
            },
        ),
        section::<base_mass::Study>(
            content,
            "Other masses of the base",
            &reports.base_mass,
            &html! {
                (figure(&figures::base_mass(reports, links)?, "Share of episodes that end within a threshold, against the mass of the cube; the policy learned with \
                    400 kg. The dashed line is the paper's 90 %, of the threshold of 50 mrad."))
            },
        ),
        reassembly(content)?,
        section::<noise::Study>(
            content,
            "Noise, delay and mass of the arms",
            &reports.noise,
            &html! {
                (figure(&figures::noise(reports, links)?, "Mean error of the last 20 steps while one thing at a time is made worse. Strengths stand side by side, not to scale."))
                @if let Some(beside) = figures::noise_beside(reports)? {
                    (figure(&beside, "The same beside others: a policy that learned with sensors that err, too (robust), and the controllers that are not learned: goal postures alone (postures), and the generalised Jacobian (jacobian)."))
                }
            },
        ),
    ];
    let learning = match content.curves {
        [] => None,
        curves => Some(learning(curves)?),
    };
    let body = html! {
        (head(content))
        (table(content))
        @for section in &sections { (section) }
        @if let Some(learning) = &learning { (learning) }
    };
    Ok(document(GENERATOR, "the paper's experiments", &body))
}

/// What this is, and what it was made with.
fn head(content: &Content<'_>) -> Markup {
    let report = &content.reports.reassembly;
    let protocol = &report.protocol;
    html! {
        h1 { "SpaceOctopus: the paper's experiments" }
        p { "The experiments of \u{201c}SpaceOctopus: An Octopus-inspired Motion Planning Framework for Multi-arm Space Robot\u{201d} \
            (Zhao, Wang, Fan, Gao, Zhang, 2024), repeated with policies that were trained with this program. Actions are deterministic, and goals are \
            held out from training; where the authors published theirs, an episode with those is shown." }
        @if content.quick {
            p { strong { "Quick: " } "few episodes and coarse settings. Leave " code { "--quick" } " out for the protocol's numbers." }
        }
        dl {
            (made(&report.provenance))
            dt { "robot" } dd { (report.robot.name) ", " code { (report.robot.blake3) } }
            dt { "episodes" } dd { (protocol.steps) " control steps of " (protocol.control_period_s) " s; seed of goals and noise: " (protocol.seed) }
            @for policy in &report.policies {
                dt { "policy, " (policy.task.as_str()) }
                dd { (identity(policy)) }
            }
        }
    }
}

fn identity(policy: &Identity) -> Markup {
    if let Some(controller) = policy.controller {
        return html! { (policy.shown()) ", not learned. " (controller.about()) };
    }
    html! {
        code { (policy.checkpoint.display()) } ", iteration " (policy.iteration) ", "
        (grouped(policy.env_steps)) " env-steps, training seed " (policy.seed) ", digest "
        span class="digest" { (policy.digest) }
    }
}

/// The claims.
fn table(content: &Content<'_>) -> Markup {
    let tally = Tally::of(content.claims);
    html! {
        h2 id="claims" { "The paper's claims" }
        p { (tally.hold) " of " (tally.of) " hold by the paper's measure, as far as it is known" (tally.not_judged()) ". The last column is stricter: the mean \
            over the last 20 steps of all episodes, from which no lucky moment can be picked. Goals that can be reached are those that a controller \
            which knows the robot reaches." }
        div class="scroll" {
            table {
                thead { tr { th { "claim" } th { "paper" } th { "ours" } th {} th { "stricter" } } }
                tbody {
                    @for claim in content.claims { (row(claim, content.links)) }
                }
            }
        }
    }
}

fn row(claim: &Claim, links: &Links) -> Markup {
    let watch = claim.episode.as_deref().and_then(|what| links.get(what));
    let class = |holds: Option<bool>| match holds {
        Some(true) => "holds",
        Some(false) => "fails",
        None => "",
    };
    let mark = |holds: bool| if holds { "✓" } else { "✗" };
    html! {
        tr {
            td {
                a href=(format!("#{}", claim.experiment)) { (claim.what) }
                @if let Some(watch) = watch { " " a class="watch" href=(watch) { "watch" } }
                small { (claim.measure) }
            }
            td class="number" { (claim.paper.text()) }
            td class="number" { @if let Some(ours) = claim.ours { (claim.paper.show(ours)) } @else { "–" } }
            td class=(class(claim.holds)) {
                @if let Some(holds) = claim.holds { (mark(holds)) " " }
                (verdict(claim.holds))
            }
            td {
                @for stricter in &claim.stricter {
                    div {
                        span class=(class(Some(stricter.holds))) { (claim.paper.show(stricter.value)) " " (mark(stricter.holds)) }
                        " " span class="note" { (stricter.measure) }
                    }
                }
            }
        }
    }
}

/// A figure with what it shows.
fn figure(svg: &str, caption: &str) -> Markup {
    html! { figure { (PreEscaped(svg)) figcaption { (caption) } } }
}

/// An experiment: its figures, what makes its numbers, and all of them.
fn section<E: Experiment>(
    content: &Content<'_>,
    title: &str,
    report: &ReportOf<E>,
    figures: &Markup,
) -> Markup {
    let Report { experiment, policies, provenance, protocol, .. } = report;
    let command = content.commands.iter().find(|(name, _)| name == experiment);
    html! {
        h2 id=(experiment) { (title) }
        (figures)
        (content.links.list(&report.episodes))
        details {
            summary { "All numbers" }
            pre { (E::table(output::COLUMNS, report)) }
        }
        dl {
            @if let Some((_, command)) = command {
                dt { "command" } dd { code { (command) " --json > " (experiment) ".json" } }
            }
            dt { "measured" } dd { (provenance.started) ", " (output::counted(protocol.episodes as u64, "episode")) " a setting" }
            @for policy in policies {
                dt { "policy" } dd { (policy.task.as_str()) ", " span class="digest" { (policy.digest) } }
            }
        }
    }
}

fn precision(content: &Content<'_>) -> anyhow::Result<Markup> {
    let reports = content.reports;
    let figures = html! {
        (figure(&figures::precision(reports, content.links)?, "Errors of each agent over the episodes. A box holds the middle half, its line is the median, whiskers \
            reach from the 10th to the 90th percentile, the dot is the mean. The minimum over time is the paper's measure."))
        (figure(&figures::courses(reports, content.links)?, "Median errors over time; the control period is 0.4 s, which the paper's figures count as 0.1 s."))
    };
    let title = "Precision";
    Ok(section::<precision::Study>(content, title, &reports.precision, &figures))
}

fn disturbance(content: &Content<'_>) -> anyhow::Result<Markup> {
    let reports = content.reports;
    let axes = figures::disturbed_axes(reports, content.links)?;
    let figures = html! {
        @if let Some(axes) = &axes {
            (figure(axes, "One episode with the authors' goals; actions are overwritten as in the released scripts. Each axis of goal − actual; the way \
                from home is cut off at the edges."))
        }
        (figure(&figures::disturbed_courses(reports, content.links)?, "Medians over held-out goals of the worst axis: overwritten actions, a push from outside, and the \
            same push taken back. What is pushed in space keeps the momentum, so after a push alone errors do not return. A force that is taken back leaves \
            angular momentum, because the hand has moved in between: errors return, and grow again as the base turns the goals out of reach."))
    };
    let title = "Disturbance";
    let report = &reports.disturbance;
    Ok(section::<disturbance::Study>(content, title, report, &figures))
}

fn reassembly(content: &Content<'_>) -> anyhow::Result<Markup> {
    let report = &content.reports.reassembly;
    let stages: Vec<Markup> = report
        .results
        .iter()
        .filter(|stage| stage.goals == Goals::Theirs)
        .zip(&report.protocol.settings.stages)
        .map(|(stage, goals)| {
            html! {
                figure {
                    @if let Some(watch) = content.links.get(&stage.trial()) {
                        a href=(watch) { (drawing::sequence(content.robot, stage, goals)) }
                    } @else {
                        (drawing::sequence(content.robot, stage, goals))
                    }
                    figcaption {
                        "Stage \u{201c}" (stage.stage) "\u{201d}, the authors' goals: blue arms turn the base, others reach for their crosses; \
                            dotted is the way of the hand."
                    }
                }
            }
        })
        .collect();
    let figures = html! {
        (figure(&figures::reassembly(content.reports, content.links)?, "Errors over time with the authors' goals: arm 2 reaches while the others turn the base; in the \
            second row arm 3 joins from step 70 on."))
        @for stage in &stages { (stage) }
    };
    Ok(section::<reassembly::Study>(content, "Reassembly", report, &figures))
}

fn learning(curves: &[Recorded]) -> anyhow::Result<Markup> {
    let (by_steps, by_time) = (families(curves, Over::EnvSteps), families(curves, Over::Time));
    Ok(html! {
        h2 id="learning" { "Learning" }
        (figure(&learning_curves(&by_steps, Over::EnvSteps)?, "Mean over the runs of one configuration within its 95 % bootstrap interval, which of three runs \
            is all that they span. Returns are of training episodes, exploration included; errors of deterministic actions on held-out goals, in the last steps."))
        (figure(&learning_curves(&by_time, Over::Time)?, "The same against the time that the trainings took."))
        p { "Where the curves end, and the env-steps until the errors are first as good as the paper's, in the median over the runs: by its own measure, the \
            minimum over time, and in the last steps." }
        div class="scroll" { table {
            thead { tr { @for cell in Family::HEADER { th { (cell) } } } }
            tbody { @for family in &by_steps { tr { @for cell in family.row(Over::EnvSteps) { td { (cell) } } } } }
        } }
        dl {
            @for family in &by_steps {
                dt { (family.name) }
                dd { @for (run, seed) in &family.runs { code { (run.display()) } " (seed " (seed) ") " } }
            }
        }
    })
}
