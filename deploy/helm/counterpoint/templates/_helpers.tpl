{{- define "counterpoint.name" -}}
{{- .Release.Name | trunc 50 | trimSuffix "-" -}}
{{- end -}}

{{- define "counterpoint.labels" -}}
app.kubernetes.io/name: counterpoint
app.kubernetes.io/instance: {{ .Release.Name }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
{{- end -}}

{{/* Labels by which one part is found; call with (dict "root" $ "part" "worker"). */}}
{{- define "counterpoint.selector" -}}
app.kubernetes.io/name: counterpoint
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .part }}
{{- end -}}

{{- define "counterpoint.account" -}}
{{- .Values.serviceAccount.name | default (include "counterpoint.name" .) -}}
{{- end -}}

{{- define "counterpoint.image" -}}
{{- printf "%scounterpoint-%s:%s" .root.Values.image.registry .image (.root.Values.image.tag | default .root.Chart.AppVersion) -}}
{{- end -}}

{{- define "counterpoint.protocol" -}}
{{- ternary "tls" "tcp" (ne .Values.tls.secret "") -}}
{{- end -}}

{{/* Endpoints of all routers: a client takes the first that answers. */}}
{{- define "counterpoint.connect" -}}
{{- $name := include "counterpoint.name" . -}}
{{- range $i := until (int .Values.router.replicas) -}}
{{- if $i }},{{ end }}{{ include "counterpoint.protocol" $ }}/{{ $name }}-router-{{ $i }}.{{ $name }}-router:7447
{{- end -}}
{{- end -}}

{{- define "counterpoint.pod" -}}
serviceAccountName: {{ include "counterpoint.account" .root }}
automountServiceAccountToken: false
enableServiceLinks: false
terminationGracePeriodSeconds: 45
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  seccompProfile: {type: RuntimeDefault}
{{- with .root.Values.image.pullSecrets }}
imagePullSecrets:
{{- range . }}
  - name: {{ . }}
{{- end }}
{{- end }}
{{- with .values.nodeSelector }}
nodeSelector: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .values.tolerations }}
tolerations: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .values.affinity }}
affinity: {{- toYaml . | nindent 2 }}
{{- end }}
{{- end -}}

{{- define "counterpoint.container" -}}
imagePullPolicy: {{ .Values.image.pullPolicy }}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
{{- end -}}

{{/* Variables of the locks of one part; call with (dict "root" $ "part" "worker"). */}}
{{- define "counterpoint.locks" -}}
{{- if .root.Values.tls.secret }}
- {name: COUNTERPOINT_TLS_CA, value: /etc/counterpoint/ca.pem}
- {name: COUNTERPOINT_TLS_CERTIFICATE, value: /etc/counterpoint/{{ .part }}.pem}
- {name: COUNTERPOINT_TLS_KEY, value: /etc/counterpoint/{{ .part }}.key}
{{- if eq .part "router" }}
- {name: COUNTERPOINT_ZENOH_CONFIG, value: /etc/counterpoint/rules.json}
{{- else }}
- {name: COUNTERPOINT_HTTP_CERTIFICATE, value: /etc/counterpoint/{{ .part }}.pem}
- {name: COUNTERPOINT_HTTP_KEY, value: /etc/counterpoint/{{ .part }}.key}
- {name: COUNTERPOINT_HTTP_TOKENS, value: /etc/counterpoint/tokens}
{{- end }}
{{- else if .root.Values.insecure }}
- {name: COUNTERPOINT_INSECURE, value: "true"}
{{- else }}
{{- fail "beyond one machine nothing listens without TLS and credentials: name a secret in tls.secret (deploy/README.md, Kubernetes), or set insecure=true if the network policy is enough" }}
{{- end }}
{{- end -}}

{{- define "counterpoint.locks-mount" -}}
{{- if .Values.tls.secret }}
- {name: locks, mountPath: /etc/counterpoint, readOnly: true}
{{- end }}
{{- end -}}

{{- define "counterpoint.locks-volume" -}}
{{- if .root.Values.tls.secret }}
- name: locks
  secret:
    secretName: {{ .root.Values.tls.secret }}
    defaultMode: 0440
    items:
      - {key: ca.pem, path: ca.pem}
      - {key: {{ .part }}.pem, path: {{ .part }}.pem}
      - {key: {{ .part }}.key, path: {{ .part }}.key}
      {{- if eq .part "router" }}
      - {key: rules.json, path: rules.json}
      {{- else }}
      - {key: tokens, path: tokens}
      {{- end }}
{{- end }}
{{- end -}}

{{- define "counterpoint.scheme" -}}
{{- ternary "HTTPS" "HTTP" (ne .Values.tls.secret "") -}}
{{- end -}}

{{- define "counterpoint.environment" -}}
- {name: COUNTERPOINT_BUCKET, value: {{ .Values.bucket | quote }}}
- {name: COUNTERPOINT_ARTIFACTS, value: {{ .Values.artifacts | quote }}}
- {name: COUNTERPOINT_ROOT, value: {{ .Values.root | quote }}}
- {name: COUNTERPOINT_CONNECT, value: {{ include "counterpoint.connect" . | quote }}}
{{- range $name, $value := .Values.settings }}
- {name: {{ $name }}, value: {{ $value | quote }}}
{{- end }}
{{- end -}}

{{- define "counterpoint.secrets" -}}
{{- with .Values.existingSecrets }}
envFrom:
{{- range . }}
  - secretRef: {name: {{ . }}}
{{- end }}
{{- end }}
{{- end -}}

{{/* How Prometheus asks one part: by the authority, under the name in its certificate, with a token. */}}
{{- define "counterpoint.scrape" -}}
{{- if .root.Values.tls.secret }}
scheme: https
tlsConfig:
  ca: {secret: {name: {{ .root.Values.tls.secret }}, key: ca.pem}}
  serverName: {{ .part }}
{{- with .root.Values.serviceMonitor.tokenSecret }}
authorization:
  credentials: {name: {{ . }}, key: token}
{{- end }}
{{- end }}
{{- end -}}
