"""Template of a contract's TOML: values known from the policy's file, and "?" for the others."""

import tomlkit

from deploy.plugins import TASKS, installed
from deploy.tasks.task import installed_sources
from policies.importers.contract_draft import ActionDraft, ContractDraft, TermDraft
from policies.importers.reference_policy import PolicyFacts
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.toml_draft import commented_document, fill
from robots.strict import PLACEHOLDER, Strict, placeholder_fields

HEAD = """Contract of {name}: {facts.kind}, {facts.observations} observations, {facts.actions} actions.
Replace every "{open}", using the training code. "none" means that there is no such value.
Observation sources, each with frame and unit:
{sources}"""


def render_template(facts: PolicyFacts, name: str) -> tuple[str, int]:
    """Return the text of the TOML, and the number of open values."""
    known, terms = facts.known, facts.known.get("observation") or [{}]
    sources = "\n".join(f"  {name}: {s.frame}, {s.unit}" for name, s in installed_sources().items())
    document = commented_document(HEAD.format(name=name, facts=facts, open=PLACEHOLDER, sources=sources))
    fields = _descriptions(ContractDraft) | {"task": f"one of {', '.join(installed(TASKS))}"}
    optional = {"action_joints"} - known.keys()
    if all(term.get("history", 1) == 1 for term in terms):
        optional |= {"layout", "frames", "fill"}
    fields = {key: text for key, text in fields.items() if key not in optional}
    fill(document, {key: known[key] for key in fields if key in known}, fields)
    observation = tomlkit.aot()
    for term in terms:
        observation.append(fill(tomlkit.table(), term, _descriptions(TermDraft)))
    document.add("observation", observation)
    document.add("action", fill(tomlkit.table(), known.get("action") or {}, _descriptions(ActionDraft)))
    if network := known.get("network"):
        missing = {key: text for key, text in _descriptions(NetworkSettings).items() if key in network}
        document.add("network", fill(tomlkit.table(), network, missing))
    return tomlkit.dumps(document), len(list(placeholder_fields(document.unwrap())))


def _descriptions(schema: type[Strict]) -> dict[str, str]:
    """Return the described fields of a record, in its order."""
    return {name: field.description for name, field in schema.model_fields.items() if field.description}
