#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes what DDS security wants: a certificate authority, rules for the domain, and for each host a certificate with
# its permissions. It needs openssl alone.
#
#     examples/secure_gateway/certificates.sh DIRECTORY DOMAIN TOPICS HOST...
#
# TOPICS: what the hosts may write and read, as DDS calls it: 'rt/*'. For each HOST it writes HOST.xml, for
# CYCLONEDDS_URI. Keep authority.key away from the hosts: with it more of them get in.
set -euo pipefail

directory=$(realpath "$1") domain=$2 topics=$3
shift 3
cd "$directory"
umask 077
days=3650
plugins=$(dirname "$(find /usr/lib /usr/local/lib -name libdds_security_auth.so -print -quit)")

sign() { openssl smime -sign -in "$1.xml" -text -out "$1.p7s" -signer authority.pem -inkey authority.key 2>/dev/null; }
key() { openssl ecparam -name prime256v1 -genkey -noout -out "$1.key"; }

key authority
openssl req -x509 -new -key authority.key -days $days -subj "/O=robot/CN=authority" -out authority.pem

# Who is no member gets nothing, and sees nothing: not even which topics there are.
cat >governance.xml <<RULES
<?xml version="1.0" encoding="utf-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:noNamespaceSchemaLocation="https://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_governance.xsd">
 <domain_access_rules><domain_rule>
  <domains><id>$domain</id></domains>
  <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
  <enable_join_access_control>true</enable_join_access_control>
  <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
  <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
  <rtps_protection_kind>NONE</rtps_protection_kind>
  <topic_access_rules><topic_rule>
   <topic_expression>*</topic_expression>
   <enable_discovery_protection>true</enable_discovery_protection>
   <enable_liveliness_protection>true</enable_liveliness_protection>
   <enable_read_access_control>true</enable_read_access_control>
   <enable_write_access_control>true</enable_write_access_control>
   <metadata_protection_kind>SIGN</metadata_protection_kind>
   <data_protection_kind>ENCRYPT</data_protection_kind>
  </topic_rule></topic_access_rules>
 </domain_rule></domain_access_rules>
</dds>
RULES
sign governance

for host in "$@"; do
  key "$host"
  openssl req -new -key "$host.key" -subj "/O=robot/CN=$host" -out request.pem
  openssl x509 -req -in request.pem -CA authority.pem -CAkey authority.key -CAcreateserial -days $days \
    -out "$host.pem" 2>/dev/null
  cat >"permissions_$host.xml" <<PERMISSIONS
<?xml version="1.0" encoding="utf-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:noNamespaceSchemaLocation="https://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">
 <permissions><grant name="$host">
  <subject_name>$(openssl x509 -noout -subject -nameopt RFC2253 -in "$host.pem" | sed 's/^subject=//')</subject_name>
  <validity><not_before>$(date -u -d yesterday +%FT%TZ)</not_before>
   <not_after>$(date -u -d "$days days" +%FT%TZ)</not_after></validity>
  <allow_rule>
   <domains><id>$domain</id></domains>
   <publish><topics><topic>$topics</topic><topic>ros_discovery_info</topic></topics></publish>
   <subscribe><topics><topic>$topics</topic><topic>ros_discovery_info</topic></topics></subscribe>
  </allow_rule>
  <default>DENY</default>
 </grant></permissions>
</dds>
PERMISSIONS
  sign "permissions_$host"
  cat >"$host.xml" <<SETTINGS
<CycloneDDS><Domain Id="any"><Security>
 <Authentication>
  <Library path="$plugins/libdds_security_auth.so" initFunction="init_authentication" finalizeFunction="finalize_authentication"/>
  <IdentityCA>file:$directory/authority.pem</IdentityCA>
  <IdentityCertificate>file:$directory/$host.pem</IdentityCertificate>
  <PrivateKey>file:$directory/$host.key</PrivateKey>
 </Authentication>
 <AccessControl>
  <Library path="$plugins/libdds_security_ac.so" initFunction="init_access_control" finalizeFunction="finalize_access_control"/>
  <PermissionsCA>file:$directory/authority.pem</PermissionsCA>
  <Governance>file:$directory/governance.p7s</Governance>
  <Permissions>file:$directory/permissions_$host.p7s</Permissions>
 </AccessControl>
 <Cryptographic>
  <Library path="$plugins/libdds_security_crypto.so" initFunction="init_crypto" finalizeFunction="finalize_crypto"/>
 </Cryptographic>
</Security></Domain></CycloneDDS>
SETTINGS
done
rm -f request.pem
