#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Judges documents by the JSON Schema of the tool, through python3-jsonschema.

    judge.py SCHEMA < DOCUMENTS     one JSON document a line; prints what is wrong, and exits 1 then
    judge.py SCHEMA --self-test     plants mistakes in good documents and sees that each is found

It is stricter than the schema that users get: an object has no member that the schema does not name. So a new
member of a document is found here until the schema has it.
"""

import copy
import json
import pathlib
import sys

import jsonschema


def closed(schema):
    """The same schema, where no object has other members than those it names."""
    if isinstance(schema, list):
        return [closed(inner) for inner in schema]
    if not isinstance(schema, dict):
        return schema
    result = {key: closed(inner) for key, inner in schema.items()}
    if schema.get('type') == 'object' and 'properties' in schema:
        result['additionalProperties'] = False
    return result


def judge_of(schema):
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(closed(schema))


def complaints(judge, document):
    named = {'$ref': '#/$defs/' + str(document.get('command')), **judge.schema}
    named.pop('oneOf')  # the one that `command` names says more clearly what is wrong
    if str(document.get('command')) not in judge.schema['$defs']:
        return [f'command: {document.get("command")!r} is none']
    wrong = [f'{"/".join(map(str, e.absolute_path))}: {e.message}' for e in judge.evolve(schema=named).iter_errors(document)]
    if not wrong and not judge.is_valid(document):
        wrong = ['fits not exactly one of the documents']
    return wrong


def places(value, path=()):
    """All paths to objects and lists in a document."""
    if isinstance(value, dict):
        yield path
        for key, inner in value.items():
            yield from places(inner, path + (key,))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from places(inner, path + (index,))


def spoilt(document):
    """The document with one member less, one more, or one of another type, for each object in it."""
    for path in places(document):
        def with_change(change, path=path):
            result = copy.deepcopy(document)
            at = result
            for step in path:
                at = at[step]
            change(at)
            return result
        target = document
        for step in path:
            target = target[step]
        yield with_change(lambda at: at.update(surprise=1))
        for key in target:
            yield with_change(lambda at, key=key: at.pop(key))
            yield with_change(lambda at, key=key: at.update({key: {'of': 'another type'}}))


def main(arguments):
    schema = json.loads(pathlib.Path(arguments[0]).read_text())
    judge = judge_of(schema)
    documents = [json.loads(line) for line in sys.stdin if line.strip()]
    wrong = [f'{d.get("command")}: {c}' for d in documents for c in complaints(judge, d)]
    count = len(documents)
    if arguments[1:] == ['--self-test']:
        planted = [s for d in documents for s in spoilt(d)]
        count = len(planted)
        wrong += [f'not found: {json.dumps(s)[:300]}' for s in planted if not complaints(judge, s)]
    print('\n'.join(wrong + [f'judge: {count} documents, {len(wrong)} complaints']))
    return 1 if wrong or count == 0 else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
