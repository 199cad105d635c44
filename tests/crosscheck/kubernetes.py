#!/usr/bin/env python3
"""Checks the manifests of deploy/jobs/kubernetes against the schemas of Kubernetes.

    .venv-tests/bin/python tests/crosscheck/kubernetes.py FILE...

kubernetes-validate knows what Kubernetes itself defines, and here every unknown field is an error. A JobSet is none of
that: its jobs are checked as Jobs, and its own fields against those that v1alpha2 of its interface has
(sigs.k8s.io/jobset/api/jobset/v1alpha2). What refers to another place in the file is followed.

Prints one line a document. Exit status 1 says what is wrong.
"""

import re
import sys

import jsonschema
import kubernetes_validate
import yaml

VERSION = "1.37"
# What those names become must be a name of the network (RFC 1123).
NAME = {"type": "string", "pattern": "^[a-z0-9]([-a-z0-9]{0,40}[a-z0-9])?$"}


def closed(required, **properties):
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


JOBS_OF_THE_SET = {"type": "array", "items": NAME}
JOB_SET = closed(
    ["replicatedJobs"],
    network=closed([], enableDNSHostnames={"type": "boolean"}, publishNotReadyAddresses={"type": "boolean"}, subdomain=NAME),
    successPolicy=closed(["operator"], operator={"enum": ["All", "Any"]}, targetReplicatedJobs=JOBS_OF_THE_SET),
    failurePolicy=closed([], maxRestarts={"type": "integer", "minimum": 0}),
    replicatedJobs={
        "type": "array",
        "minItems": 1,
        "items": closed(
            ["name", "template"],
            name=NAME,
            replicas={"type": "integer", "minimum": 1},
            template=closed(["spec"], metadata={"type": "object"}, spec={"type": "object"}),
        ),
    },
)


def check_job_set(document):
    """What is wrong beyond the schemas, a sentence each."""
    name, spec = document["metadata"]["name"], document["spec"]
    jsonschema.validate(spec, JOB_SET)
    jobs = {job["name"]: job["template"]["spec"] for job in spec["replicatedJobs"]}
    for job, job_spec in jobs.items():
        whole = {"apiVersion": "batch/v1", "kind": "Job", "metadata": {"name": job}, "spec": job_spec}
        kubernetes_validate.validate(whole, VERSION, strict=True)
    for job in spec["successPolicy"]["targetReplicatedJobs"]:
        if job not in jobs:
            yield "the success policy names the job %s, which there is not" % job
    subdomain = spec["network"]["subdomain"]
    hosts = {"%s-%s-0-%d.%s" % (name, job, index, subdomain) for job in jobs for index in range(jobs[job]["parallelism"])}
    for job, job_spec in jobs.items():
        pod = job_spec["template"]["spec"]
        volumes = {volume["name"] for volume in pod["volumes"]}
        for container in pod["containers"]:
            mounts = {mount["name"] for mount in container["volumeMounts"]}
            if mounts != volumes:
                yield "%s: volumes and mounts differ: %s" % (job, sorted(mounts ^ volumes))
            if "/dev/shm" not in [mount["mountPath"] for mount in container["volumeMounts"]]:
                yield "%s: /dev/shm is the container's own, which is too small" % job
            for word in container.get("args", []):
                endpoint = re.fullmatch(r"(?:quic|tcp)/(.+):\d+", word)
                if endpoint and endpoint[1] not in hosts:
                    yield "%s joins %s, which is none of %s" % (job, endpoint[1], sorted(hosts))


def main(files):
    wrong = []
    for file in files:
        with open(file, encoding="utf-8") as text:
            documents = list(yaml.safe_load_all(text))
        for document in documents:
            what = "%s %s" % (document["kind"], document["metadata"]["name"])
            try:
                if document["kind"] == "JobSet":
                    wrong += ["%s: %s: %s" % (file, what, sentence) for sentence in check_job_set(document)]
                else:
                    kubernetes_validate.validate(document, VERSION, strict=True)
            except (jsonschema.ValidationError, kubernetes_validate.ValidationError) as error:
                wrong.append("%s: %s: %s" % (file, what, str(error).splitlines()[0]))
            print(what)
    for sentence in wrong:
        print(sentence, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
