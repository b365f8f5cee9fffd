// SPDX-License-Identifier: Apache-2.0

// A program of ROS 2 for the tests of the gateway: by @foxglove/ros2, with the definitions of Humble.
//
//     ros2_peer.mjs ADDRESS receive TOPIC TYPE COUNT     prints so many messages as JSON, one a line
//     ros2_peer.mjs ADDRESS send TOPIC TYPE JSON         writes the message until it is killed
//     ros2_peer.mjs ADDRESS frames TOPIC SIZE            writes frames as gateway_node does, until it is killed
//
// What comes is decoded, encoded again by @foxglove/rosmsg2-serialization, and the bytes are compared.

import { begin, load } from '../../examples/ros2_node.mjs';

const { ddsToRosTopic, rosTopicToDds, rosTypeToDds } = load('@foxglove/ros2');
const { parse } = load('@foxglove/rosmsg');
const { ros2humble } = load('@foxglove/rosmsg-msgs-common');
const { MessageReader, MessageWriter } = load('@foxglove/rosmsg2-serialization');
const rtps = load('@foxglove/rtps');

const FRAME = 'robot/msg/Frame';
const OF_LOT = { 'robot/Frame': { name: 'robot/Frame', definitions: parse('uint32 number\nstring label\nuint8[] data', { ros2: true })[0].definitions } };
const PERIOD_MS = 50;

/** The definition of a type, and those of the types in it. */
const definitions = (type) => {
  const all = { ...ros2humble, ...OF_LOT };
  const found = new Map();
  const add = (name) => {
    if (found.has(name)) return;
    found.set(name, all[name]);
    for (const field of all[name].definitions) if (field.isComplex) add(field.type);
  };
  add(type.replace('/msg/', '/'));
  return [...found.values()];
};

/** As DDS sends it: whole words. */
const padded = (bytes) => Buffer.concat([bytes, Buffer.alloc(-bytes.length & 3)]);

const receive = (node, topic, type, count) => {
  const types = definitions(type);
  const reader = new MessageReader(types);
  const writer = new MessageWriter(types);
  let left = Number(count);
  node.subscribe({ topic, dataType: type, skipParsing: true }).on('message', (_, __, data) => {
    if (left === 0) return;
    const message = reader.readMessage(data);
    const again = padded(writer.writeMessage(message));
    if (!again.equals(padded(data))) {
      console.log(`${Buffer.from(data).toString('hex')} has come, and ${again.toString('hex')} is what was meant`);
      process.exit(1);
    }
    const plain = (_key, value) => (typeof value === 'bigint' ? `${value}` : ArrayBuffer.isView(value) ? [...value] : value);
    console.log(JSON.stringify(message, plain));
    if (--left === 0) process.exit(0);
  });
};

/**
 * A writer, which @foxglove/ros2 does not have: the participant gets one by what it has for its own. The function that
 * comes back writes bytes, to readers that are known by then.
 */
const advertise = (node, topic, type) => {
  const participant = node._participant;
  const { guidPrefix, protocolVersion, vendorId } = participant.attributes;
  const endpoint = {
    guidPrefix,
    entityId: rtps.makeEntityId(participant.nextEndpointId++, rtps.EntityKind.AppdefWriterNoKey),
    topicName: rosTopicToDds(topic),
    typeName: rosTypeToDds(type),
    durability: rtps.Durability.TransientLocal,
    reliability: { kind: rtps.Reliability.Reliable, maxBlockingTime: { sec: 1, nsec: 0 } },
    history: { kind: rtps.HistoryKind.KeepLast, depth: 1 },
    protocolVersion,
    vendorId,
  };
  const guid = rtps.makeGuid(guidPrefix, endpoint.entityId);
  const writer = new rtps.Writer(endpoint);
  participant._writers.set(endpoint.entityId, writer);
  node.on('discoveredSubscription', (reader) => {
    if (ddsToRosTopic(reader.topicName)?.topic !== topic) return;
    const peer = participant._participants.get(reader.guidPrefix);
    peer.localWriterIdToRemoteReaderIds.set(endpoint.entityId, [reader.entityId]);
  });

  const change = (of, instanceHandle, data) => ({
    timestamp: { sec: Math.floor(Date.now() / 1000), nsec: 0 },
    kind: rtps.ChangeKind.Alive,
    writerGuid: rtps.makeGuid(guidPrefix, of.attributes.entityId),
    sequenceNumber: of.history.nextSequenceNum(),
    data,
    instanceHandle,
  });
  const publications = participant._writers.get(rtps.EntityIdBuiltin.PublicationsWriter);
  const said = new rtps.Parameters();
  said.topicName(endpoint.topicName);
  said.typeName(endpoint.typeName);
  for (const key of ['durability', 'reliability', 'history', 'protocolVersion', 'vendorId']) said[key](endpoint[key]);
  said.endpointGuid(guid);
  said.finish();
  publications.history.set(change(publications, guid, said.data));
  void participant.sendMetatrafficChanges(publications);
  return (bytes) => {
    writer.history.set(change(writer, '', bytes));
    void participant.sendDefaultChanges(writer);
  };
};

const send = (node, topic, type, json) => {
  const bytes = new MessageWriter(definitions(type)).writeMessage(JSON.parse(json));
  const write = advertise(node, topic, type);
  setInterval(() => write(bytes), PERIOD_MS);
};

const frames = (node, topic, size) => {
  const writer = new MessageWriter(definitions(FRAME));
  const write = advertise(node, topic, FRAME);
  let number = 0;
  setInterval(() => {
    ++number;
    const data = Uint8Array.from({ length: Number(size) }, (_, i) => number * 31 + i * 7 + Math.floor(i / 251));
    write(writer.writeMessage({ number, label: `frame ${number}`, data }));
  }, PERIOD_MS);
};

const [address, verb, ...words] = process.argv.slice(2);
({ receive, send, frames })[verb](await begin('ros2_peer', address), ...words);
